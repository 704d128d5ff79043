"""``mbcacq collect``: clouds that a scanner's own program saved, brought together with a plan."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.terminal import echo

if TYPE_CHECKING:
    from mbcacq.workflow.collect import PairedClouds


@click.command("collect")
@click.argument("plan", type=PlanPath())
@click.option("--clouds", type=click.Path(path_type=Path), required=True, help="Folder of the clouds (PLY, PCD, STL, XYZ, ASC, TIFF ...).")
@click.option("--joints", type=click.Path(path_type=Path), help="Joint angles as the controller logged them (.csv, .dat, .log).")
@click.option(
    "--poses", "table", type=click.Path(path_type=Path), help="poses.csv of the robot program [default: the one among the clouds]."
)
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [default: runs/TIME_NAME].")
@click.option("--resume", type=RunPath(), help="Add to this run folder what it lacks.")
@click.option(
    "--unit", type=click.Choice(["mm", "m", "cm", "um", "in", "inch"]), help="Unit of the clouds [default: the plan's, the files', or mm]."
)
@click.option("--axes", help="Axes of the clouds that are the scanner frame's x, y, z, such as 'x -y -z' [default: the plan's].")
@click.option("--range-map", help="Scale of TIFF range maps: mm a column, mm a row, mm a count, mm at count 0.")
@click.option("--by", type=click.Choice(["auto", "number", "time"]), default="auto", show_default=True, help="Order of the clouds.")
@click.option("--check", is_flag=True, help="Only pair the clouds with the poses and say what is odd; record nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
def command(
    plan: Path,
    clouds: Path,
    joints: Path | None,
    table: Path | None,
    out: Path | None,
    resume: Path | None,
    unit: str | None,
    axes: str | None,
    range_map: str | None,
    by: str,
    check: bool,
    as_json: bool,
) -> None:
    """Pair the clouds of a folder with the poses of PLAN, find the balls, judge them, and calibrate: a run without drivers.

    The arm went through the poses by a program (`mbcacq plan program`) or by hand; the scanner's own program saved a cloud at each.

    \b
    Examples:
      mbcacq collect my-cell.yaml --clouds clouds --joints mbcacq_poses.csv
      mbcacq collect my-cell.yaml --clouds more-clouds --resume latest
    """
    import mbcacq
    from mbcacq.cli.progress import RunProgress
    from mbcacq.cli.signals import end_in_order_on_signals
    from mbcacq.cli.step_progress import StepProgress
    from mbcacq.plan import load
    from mbcacq.spheres.cloud_files import CloudFormat

    end_in_order_on_signals()
    steps = StepProgress()
    loaded = load(plan)
    given = loaded.plan.scanner.options
    form = CloudFormat(unit or given.get("unit"), axes or str(given.get("axes", "x y z")), scale_of(range_map or given.get("range_map")))
    operator = mbcacq.Operator(
        message=lambda sentence: echo(sentence, err=True), progress=steps.begin, subscribers=(RunProgress(steps.begin),)
    )
    if check:
        from mbcacq.workflow.collect import pair_clouds

        with steps:
            paired = pair_clouds(loaded, mbcacq.Sources(clouds, form, by, joints, table), operator=operator)
        print_pairs(paired, as_json)
        if not as_json:
            said = [word for option, file in (("--joints", joints), ("--poses", table)) if file for word in (option, file)]
            say_next("make a run of them", command_line("collect", plan, "--clouds", clouds, *said))
        return
    with steps:
        done = mbcacq.collect(loaded, mbcacq.Sources(clouds, form, by, joints, table), out=out, resume=resume, operator=operator)
    if as_json:
        echo(json.dumps(done.to_dict()))
    else:
        from mbcacq.cli.calibrate import print_result

        print_result(done.to_dict())
        say_next(*done.next_step)
    done.refuse_beyond_limit()


def print_pairs(paired: PairedClouds, as_json: bool) -> None:
    """Which cloud belongs to which pose, and what is odd."""
    pairs = {here.pose.number: [path.name for path in here.clouds] for here in paired.poses}
    if as_json:
        echo(json.dumps({"format": "mbcacq-collect-check/1", "poses": pairs, "notes": [text for _, text in paired.notes]}))
        return
    for number, names in pairs.items():
        echo(f"pose {number}: {', '.join(names)}")
    for _, text in paired.notes:
        echo(f"odd: {text}")
    echo(f"{len(pairs)} of {len(paired.session.poses)} poses have clouds")


def scale_of(given: object) -> tuple[float, float, float, float] | None:
    """Four numbers of a range map, as text or a list. Raises ConfigError."""
    from mbcacq.errors import ConfigError

    if given is None:
        return None
    words = given.replace(",", " ").split() if isinstance(given, str) else given
    try:
        dx, dy, dz, z0 = (float(word) for word in words)  # type: ignore[union-attr]
    except (TypeError, ValueError):
        raise ConfigError(f"'{given}' is no scale of a range map; give mm a column, mm a row, mm a count, mm at count 0") from None
    return dx, dy, dz, z0
