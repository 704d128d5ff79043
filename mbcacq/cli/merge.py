"""``mbcacq merge``: the scans of a part as one cloud, and how well they agree."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
from rich.table import Table

from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import titled_table
from mbcacq.parts import merge
from mbcacq.workflow import load, merge_scans

SHOWN = 10  # pairs of scans, the worst first


@subcommand("merge")
def command(
    source: Path = argument(RunPath(), metavar="RUN|FOLDER"),
    result: Path | None = option("Calibrated cell: a result.json or a run folder [default: that of RUN]."),
    station: str | None = option("Where the part stood, if parts stood at several stations."),
    voxel_mm: float | None = option(
        "mm: of each voxel the best known point stays [default: the scans' spacing].", click.FloatRange(0.01, 1000.0), "--voxel"
    ),
    cad: Path | None = option("Mesh of the part's design in mm (STL, PLY, OBJ, OFF), to compare with."),
    as_placed: bool = option("With --cad: compare where the plan says that the part stands, without a best fit."),
    surface: bool = option("Also write the surface through the cloud (STL)."),
    out: Path | None = option("PLY to write [default: merged.ply in RUN].", FILE),
    force: bool = option("Replace files that are already there."),
) -> Answer:
    """Merge the scans of a part in RUN (a run folder, or an observation set with scans) into one cloud in the robot's base frame.

    The calibrated cell places every scan, with the effects that it knows. The command measures how far overlapping scans are apart, before
    and after the calibration, and says what the calibration lets expect. Each point of the cloud has its normal, the number of its scan and
    its standard uncertainty along the normal (sigma_mm).

    Example: mbcacq run plans/part.yaml --dry-run && mbcacq merge latest

    Example: mbcacq merge latest --cad part.stl --surface
    """
    cloud = out or (source if source.is_dir() else source.parent) / "merged.ply"
    stl = cloud.with_suffix(".stl")
    for path in (cloud, *((stl,) if surface else ())):
        load.refuse_existing(path, force, f"{path} exists; give another --out, or --force to replace it")
    with StepProgress() as steps:
        done = merge_scans.merge_scans(
            source, cloud, result=result, station=station, voxel_mm=voxel_mm, cad=cad, fit=not as_placed, progress=steps.begin
        )
        kept = done.write(cloud)
        if surface:
            steps.begin("fitting the surface")
            merge.surface_mesh(cloud, stl)
    lines = [f"cloud: {cloud}; figures: {kept[0]}", *([f"surface: {stl}"] if surface else ())]
    document = done.to_dict() | ({"surface": str(stl)} if surface else {})
    return Answer(document, [*_shown(done), *lines], ("look at it", command_line("view", kept[1])))


def _shown(done: merge_scans.MergedPart) -> Iterator[str | Table]:
    found = done.agreement
    yield found.sentence
    title = f"worst of {len(found.pairs)} overlaps, 3D rms in mm (expected: k = 1; not determined: how both scans slide on each other)"
    table = titled_table(title, "poses", *found.names, "expected", "not determined", left=["poses", "not determined"])
    best = found.names[-1]
    for pair in sorted(found.pairs, key=lambda one: -one.by_placement[best] / one.expected_mm)[:SHOWN]:
        values = [f"{pair.by_placement[name]:.3f}" for name in found.names]
        table.add_row("{}, {}".format(*pair.poses), *values, f"{pair.expected_mm:.3f}", "; ".join(pair.step.undetermined))
    yield table
    if found.alone:
        yield f"note: no other scan overlaps with that of pose {', '.join(map(str, found.alone))}"
    merged = done.merged
    yield f"{merged.kept} of {merged.read} points of {merged.scans} scans kept, one in each voxel of {done.voxel_mm:.3g} mm"
    yield f"standard uncertainty along the normal: {1e3 * merged.sigma_mm:.1f} µm, at most {1e3 * merged.worst_mm:.1f} µm"
    if done.deviations is not None:
        yield done.deviations.sentence
