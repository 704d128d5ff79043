"""``mbcacq view``: a recording in the rerun viewer."""

from __future__ import annotations

from pathlib import Path

from mbcacq.cli.declared import FOLDER, argument, option, subcommand
from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording.rrd import layout, reader
from mbcacq.recording.viewer import open_viewer
from mbcacq.workflow import load


@subcommand("view")
def command(
    run: Path = argument(RunPath(every_kind=True)),
    screenshot: Path | None = option(
        "Write a picture of each tab (PNG) into this folder instead of opening a window.", FOLDER, metavar="DIR"
    ),
    pose: int | None = option("With --screenshot: at the end of this pose [default: the last]."),
    size: str = option("Size of the picture in points.", default="1600x1000", metavar="WxH"),
) -> None:
    """Open RUN in the rerun viewer: the cell, its motion, the spheres, calibration and diagnosis as tabs.

    RUN is a run folder ('latest': the newest in runs) or a .rrd file.

    \b
    Examples:
      mbcacq view latest
      mbcacq view runs/today --screenshot pictures/ --pose 30

    The viewer is started so that it reports no usage and looks for no update.
    """
    end_in_order_on_signals("the viewer")
    sources = open_viewer.files(run)
    if screenshot is None:
        open_viewer.view(sources, lambda: echo("opening the viewer; close its window to end", err=True))
        say_next_after(run)
        return
    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 200 <= int(width) <= 8000 and 200 <= int(height) <= 8000):
        raise ConfigError(f"--size {size}: give width and height between 200 and 8000, such as 1600x1000")
    with StepProgress() as progress:
        pictures = open_viewer.screenshots(sources, screenshot, (int(width), int(height)), pose, progress)
    for picture in pictures:
        echo(str(picture))
    say_next_after(run)


def say_next_after(shown: Path) -> None:
    """What to do after a look at a recording; nothing where it is of a result or a diagnosis by itself, or of another program."""
    folder = shown if shown.is_dir() else shown.parent
    if load.is_run_folder(folder) and (shown.is_dir() or shown.name in (layout.RESULT_FILE, layout.DIAGNOSIS_FILE)):
        say_next("read the figures", command_line("report", folder))
        return
    try:
        measured = next(iter(reader.Recording(shown).rows(layout.OBSERVATION)), None)
    except RecordingError:
        return
    if measured is not None:
        say_next("calibrate with it", command_line("calibrate", shown))
