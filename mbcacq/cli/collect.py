"""``mbcacq collect``: clouds that a scanner's own program saved, brought together with a plan."""

from __future__ import annotations

from pathlib import Path

import mbcacq
from mbcacq import plan as plans
from mbcacq.cli import progress
from mbcacq.cli.calibrate import answer_of_run
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.errors import ConfigError
from mbcacq.workflow import collect


@subcommand("collect")
def command(
    plan: Path = argument(PlanPath()),
    clouds: Path = option("Folder of the clouds (PLY, PCD, STL, XYZ, ASC, TIFF ...).", required=True),
    joints: Path | None = option("Joint angles as the controller logged them (.csv, .dat, .log)."),
    table: Path | None = option("poses.csv of the robot program [default: the one among the clouds].", None, "--poses"),
    out: Path | None = option("Run folder [default: runs/TIME_NAME]."),
    resume: Path | None = option("Add to this run folder what it lacks.", RunPath()),
    unit: str | None = option("Unit of the clouds [default: the plan's, the files', or mm].", ["mm", "m", "cm", "um", "in", "inch"]),
    axes: str | None = option("Axes of the clouds that are the scanner frame's x, y, z, such as 'x -y -z' [default: the plan's]."),
    range_map: str | None = option("Scale of TIFF range maps: mm a column, mm a row, mm a count, mm at count 0."),
    by: str = option("Order of the clouds.", ["auto", "number", "time"], default="auto"),
    check: bool = option("Only pair the clouds with the poses and say what is odd; record nothing."),
) -> Answer:
    """Pair the clouds of a folder with the poses of PLAN, find the balls, judge them, and calibrate: a run without drivers.

    The arm went through the poses by a program (`mbcacq plan program`) or by hand; the scanner's own program saved a cloud at each.

    \b
    Examples:
      mbcacq collect my-cell.yaml --clouds clouds --joints mbcacq_poses.csv
      mbcacq collect my-cell.yaml --clouds more-clouds --resume latest
    """
    from mbcacq.spheres.cloud_files import CloudFormat

    end_in_order_on_signals()
    steps = StepProgress()
    loaded = plans.load(plan)
    given = loaded.plan.scanner.options
    form = CloudFormat(unit or given.get("unit"), axes or str(given.get("axes", "x y z")), scale_of(range_map or given.get("range_map")))
    operator = mbcacq.Operator(
        message=lambda sentence: echo(sentence, err=True), progress=steps.begin, subscribers=(progress.RunProgress(steps.begin),)
    )
    if check:
        with steps:
            paired = collect.pair_clouds(loaded, mbcacq.Sources(clouds, form, by, joints, table), operator=operator)
        pairs = {here.pose.number: [path.name for path in here.clouds] for here in paired.poses}
        odd = [text for _, text in paired.notes]
        lines = [*(f"pose {number}: {', '.join(names)}" for number, names in pairs.items()), *(f"odd: {text}" for text in odd)]
        lines.append(f"{len(pairs)} of {len(paired.session.poses)} poses have clouds")
        said = [word for option, file in (("--joints", joints), ("--poses", table)) if file for word in (option, file)]
        then = "make a run of them", command_line("collect", plan, "--clouds", clouds, *said)
        return Answer({"format": "mbcacq-collect-check/1", "poses": pairs, "notes": odd}, lines, then)
    with steps:
        done = mbcacq.collect(loaded, mbcacq.Sources(clouds, form, by, joints, table), out=out, resume=resume, operator=operator)
    return answer_of_run(done)


def scale_of(given: object) -> tuple[float, float, float, float] | None:
    """Four numbers of a range map, as text or a list. Raises ConfigError."""
    if given is None:
        return None
    words = given.replace(",", " ").split() if isinstance(given, str) else given
    try:
        dx, dy, dz, z0 = (float(word) for word in words)  # type: ignore[union-attr]
    except (TypeError, ValueError):
        raise ConfigError(f"'{given}' is no scale of a range map; give mm a column, mm a row, mm a count, mm at count 0") from None
    return dx, dy, dz, z0
