"""``mbcacq view``: a recording in the rerun viewer."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("view")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--screenshot", type=click.Path(path_type=Path, dir_okay=False), help="Write a picture (PNG) instead of opening a window.")
@click.option("--pose", type=int, help="With --screenshot: at the end of this pose [default: the last].")
@click.option("--size", default="1600x1000", show_default=True, metavar="WxH", help="Size of the picture in points.")
def command(run: Path, screenshot: Path | None, pose: int | None, size: str) -> None:
    """Open RUN (a run folder or a .rrd file) in the rerun viewer, with the cell, the curves and the log laid out.

    The viewer of rerun reports anonymous usage unless told not to: rerun analytics disable
    """
    from mbcacq.errors import ConfigError
    from mbcacq.recording import viewer

    sources = viewer.files(run)
    if screenshot is None:
        viewer.view(sources)
        return
    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 200 <= int(width) <= 8000 and 200 <= int(height) <= 8000):
        raise ConfigError(f"--size {size}: give width and height between 200 and 8000, such as 1600x1000")
    viewer.screenshot(sources, screenshot, (int(width), int(height)), pose)
    click.echo(str(screenshot))
