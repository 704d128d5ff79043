"""``mbcacq merge``: the scans of a part as one cloud, and how well they agree."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import console, echo

if TYPE_CHECKING:
    from mbcacq.workflow.merge_scans import MergedPart

SHOWN = 10  # pairs of scans, the worst first


@click.command("merge")
@click.argument("source", metavar="RUN|FOLDER", type=RunPath())
@click.option("--result", type=click.Path(path_type=Path), help="Calibrated cell: a result.json or a run folder [default: that of RUN].")
@click.option("--station", help="Where the part stood, if parts stood at several stations.")
@click.option(
    "--voxel",
    "voxel_mm",
    type=click.FloatRange(0.01, 1e3),
    help="mm: of each voxel the best known point stays [default: the scans' spacing].",
)
@click.option("--cad", type=click.Path(path_type=Path), help="Mesh of the part's design in mm (STL, PLY, OBJ, OFF), to compare with.")
@click.option("--as-placed", is_flag=True, help="With --cad: compare where the plan says that the part stands, without a best fit.")
@click.option("--surface", is_flag=True, help="Also write the surface through the cloud (STL).")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="PLY to write [default: merged.ply in RUN].")
@click.option("--force", is_flag=True, help="Replace files that are already there.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(
    source: Path,
    result: Path | None,
    station: str | None,
    voxel_mm: float | None,
    cad: Path | None,
    as_placed: bool,
    surface: bool,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Merge the scans of a part in RUN (a run folder, or an observation set with scans) into one cloud in the robot's base frame.

    The calibrated cell places every scan, with the effects that it knows. The command measures how far overlapping scans are apart, before
    and after the calibration, and says what the calibration lets expect. Each point of the cloud has its normal, the number of its scan and
    its standard uncertainty along the normal (sigma_mm).

    Example: mbcacq run plans/part.yaml --dry-run && mbcacq merge latest

    Example: mbcacq merge latest --cad part.stl --surface
    """
    from mbcacq.parts.merge import surface_mesh
    from mbcacq.workflow.load import refuse_existing
    from mbcacq.workflow.merge_scans import merge_scans

    cloud = out or (source if source.is_dir() else source.parent) / "merged.ply"
    stl = cloud.with_suffix(".stl")
    for path in (cloud, *((stl,) if surface else ())):
        refuse_existing(path, force, f"{path} exists; give another --out, or --force to replace it")
    with StepProgress() as steps:
        done = merge_scans(
            source, cloud, result=result, station=station, voxel_mm=voxel_mm, cad=cad, fit=not as_placed, progress=steps.begin
        )
        kept = done.write(cloud)
        if surface:
            steps.begin("fitting the surface")
            surface_mesh(cloud, stl)
    if as_json:
        echo(json.dumps(done.to_dict() | ({"surface": str(stl)} if surface else {})))
        return
    _show(done)
    echo(f"cloud: {cloud}; figures: {kept[0]}")
    if surface:
        echo(f"surface: {stl}")
    say_next("look at it", command_line("view", kept[1]))


def _show(done: MergedPart) -> None:
    from rich.table import Table

    found = done.agreement
    echo(found.sentence)
    table = Table(title=f"worst of {len(found.pairs)} overlaps, 3D rms in mm (expected: k = 1)", title_justify="left")
    for heading in ("poses", *found.names, "expected", "not determined"):
        table.add_column(heading, justify="left" if heading in ("poses", "not determined") else "right")
    best = found.names[-1]
    for pair in sorted(found.pairs, key=lambda one: -one.by_placement[best] / one.expected_mm)[:SHOWN]:
        values = [f"{pair.by_placement[name]:.3f}" for name in found.names]
        table.add_row("{}, {}".format(*pair.poses), *values, f"{pair.expected_mm:.3f}", "; ".join(pair.step.undetermined))
    console().print(table)
    if found.alone:
        echo(f"note: no other scan overlaps with that of pose {', '.join(map(str, found.alone))}")
    merged = done.merged
    echo(f"{merged.kept} of {merged.read} points of {merged.scans} scans kept, one in each voxel of {done.voxel_mm:.3g} mm")
    echo(f"standard uncertainty along the normal: {1e3 * merged.sigma_mm:.1f} µm, at most {1e3 * merged.worst_mm:.1f} µm")
    if done.deviations is not None:
        echo(done.deviations.sentence)
