"""``mbcacq plan design``: better poses for a plan, or a motion that tells what a recording of torque does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.table import Table

from mbcacq import plan as plans
from mbcacq.cli.declared import Answer, argument, option, subcommand
from mbcacq.cli.next_step import command_line
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo, titled_table
from mbcacq.design import excitation, optimal_design, part_coverage, plan_comparison, planned_scope, station_repair
from mbcacq.design.adaptive import plan_order
from mbcacq.errors import ConfigError
from mbcacq.files import atomic_write, mesh_file
from mbcacq.quantities import significant
from mbcacq.workflow import load


@subcommand("design")
def design(
    plan: Path = argument(PlanPath()),
    count: int | None = option("Number of calibration poses to choose (needed without --motion).", click.IntRange(6, 400), "--poses"),
    motion: tuple[Path, ...] = option(
        "Design a motion instead that separates masses, a load on the flange and a balancer at A2, beginning with this recording of "
        "torque (a trajectory set or a run; repeatable).",
        click.Path(path_type=Path, exists=True),
        metavar="RECORDING",
    ),
    order: bool = option(
        "Order the poses instead, those of PLAN and better ones, so that the first few show most: after 24 of them a diagnosis may say "
        "that there is no effect, and a run may stop at any time."
    ),
    part: Path | None = option(
        "Choose the views of the first `do: scan` step instead, by the surface they show: of MESH (mm, the part's frame), or of the mesh "
        "that the part's file names.",
        click.Path(path_type=Path),
        flag_value=Path(),
        metavar="[MESH]",
        is_flag=False,
    ),
    seconds: float = option("Duration of that motion.", click.FloatRange(5, 120), default=20.0),
    out: Path | None = option(
        "The new plan [default: NAME_designed.yaml in the folder of PLAN], or the table of the motion [default: NAME_motion.csv]."
    ),
    criterion: str = option(
        "A: mean variance of the certified distances; D: volume of the parameters' confidence region.", ["A", "D"], default="A"
    ),
    tilt: float = option("Steepest view, in °.", click.FloatRange(5, 60), default=40.0),
    seed: int = option("Seed of the random views to choose from, and of the simulated cells.", default=0),
    force: bool = option("Replace the file if it exists."),
) -> Answer:
    """Choose better calibration poses for PLAN at its own stations, and write a new plan.

    Views that can be taken are drawn at random; the best of them are chosen by greedy growth and exchange. The poses of the phases
    'translation', 'orientation' and 'verification' stay. Both plans are then compared, in expectation and by simulated cells.

    With --motion a motion is designed instead, in the cell of PLAN and within its limits: it begins and ends at home, and is written as a
    table of times and joint angles. It is checked against collisions with no artefact in place.

    With --order as many poses as PLAN has (or --poses) are ordered in blocks. Each block is the best continuation of those before it: it
    shows most of all effects of the catalogue, per second of motion, scan and artefact move.

    With --part the fewest views are sought that show 98 % of what can be seen of a part at all, each overlapping with others.
    """
    if part is not None:
        return cover_part(plan, part, out or plan.with_name(f"{plan.stem}_covering.yaml"), tilt, seed, force)
    if motion:
        return design_motion(plan, motion, seconds, out or plan.with_name(f"{plan.stem}_motion.csv"), seed, force)
    if order:
        return order_plan(plan, count, out or plan.with_name(f"{plan.stem}_ordered.yaml"), tilt, seed, force)
    from mbcacq.plan.expansion import expand_reachable

    if count is None:
        raise ConfigError("nothing is asked for; give --poses N for a plan, or --motion RECORDING for a motion")
    target = out or plan.with_name(f"{plan.stem}_designed.yaml")
    refuse_taken(target, force, beside=plan)
    loaded, repairs = station_repair.repaired(plans.load(plan))
    for sentence in repairs:
        echo(sentence, err=True)
    with StepProgress("choosing views by what the calibration learns from them") as steps:
        result = optimal_design.design(loaded, count, criterion=criterion, steepest_deg=tilt, seed=seed)
        atomic_write.write_file(target, result.text)
        new = plans.load(target)
        poses = plans.expand(new)
        steps.begin("comparing both plans by simulated cells")
        rows = plan_comparison.compare([(loaded, expand_reachable(loaded)[0]), (new, poses)], seed)
    if sentence := planned_scope.scope_sentence(new, poses):
        echo(sentence, err=True)
    how = {"plan": str(target), "tried": result.tried, "criterion": criterion}
    return Answer(
        {"format": "mbcacq-plan-design/1", **how, "given": rows[0], "designed": rows[1]},
        [_comparison(rows), f"chosen from {result.tried} views that can be taken; written to {target}"],
        ("try it without hardware", command_line("run", target, "--dry-run")),
    )


def refuse_taken(target: Path, force: bool, beside: Path | None = None) -> None:
    """Raise ConfigError where a file is there already, or does not lie beside the plan whose files it names."""
    load.refuse_existing(target, force, f"{target} exists already; give another --out, or --force to replace it")
    if beside is not None and target.resolve().parent != beside.resolve().parent:
        raise ConfigError(f"{target}: a plan names its robot and artefacts relative to itself; put the new one beside {beside}")


def write_whole(text: str, out: Path) -> None:
    """Write a plan, none of whose poses has an error."""
    new = plans.load(out, text)
    plans.refuse_errors(new, plans.expand(new))
    atomic_write.write_file(out, text)


def cover_part(plan: Path, part: Path, out: Path, tilt: float, seed: int, force: bool) -> Answer:
    """Choose views of a part, write the plan, and say what they show."""
    refuse_taken(out, force, beside=plan)
    with StepProgress("choosing views by the surface that they show"):
        found = part_coverage.design_part(plans.load(plan), None if part == Path() else mesh_file.read_mesh(part), tilt, seed)
        write_whole(found.text, out)
    figures = {"views": found.views, "covered": found.covered, "visible": found.visible, "tried": found.tried}
    return Answer(
        {"format": "mbcacq-part-design/1", "plan": str(out), **figures},
        [
            f"{found.views} views show {found.covered:.1%} of what can be seen of the part; that is {found.visible:.1%} of its surface",
            f"chosen from {found.tried} views that can be taken; written to {out}",
        ],
        ("try it without hardware", command_line("run", out, "--dry-run")),
    )


def order_plan(plan: Path, count: int | None, out: Path, tilt: float, seed: int, force: bool) -> Answer:
    """Order a plan, write it, and say what its blocks carry."""
    refuse_taken(out, force, beside=plan)
    with StepProgress("leaving out what is missed least, pose by pose"):
        found = plan_order.ordered(plans.load(plan), count, tilt, seed)
        write_whole(found.text, out)
    ends = [sum(found.blocks[: k + 1]) for k in range(len(found.blocks))]
    shares = dict(zip(map(str, ends), found.shares, strict=True))
    lines = [
        f"after {end:3d} poses: {share:.0%} of what all poses of {plan.name} show" for end, share in zip(ends, found.shares, strict=True)
    ]
    return Answer(
        {"format": "mbcacq-plan-order/1", "plan": str(out), "tried": found.tried, "share_of_given_after": shares},
        [*lines, f"chosen from {found.tried} poses that can be taken; written to {out}"],
        ("try it without hardware", command_line("run", out, "--dry-run")),
    )


def design_motion(plan: Path, recordings: tuple[Path, ...], seconds: float, out: Path, seed: int, force: bool) -> Answer:
    """Design a motion, write its table, and say what it is expected to tell."""
    refuse_taken(out, force)
    found = excitation.design_excitation(plans.load(plan), load.load_trajectories(*recordings), seconds, seed)
    atomic_write.write_file(out, found.table())
    std = {name: {"before": float(b), "after": float(a)} for name, b, a in zip(found.names, found.before, found.after, strict=True)}
    correlation = {"before": dict(found.correlation_before), "after": dict(found.correlation_after)}
    table = titled_table("expected standard deviations", "parameter", "recorded", "with this motion", left=["parameter"])
    for name, of in std.items():
        table.add_row(name, significant(of["before"], 2), significant(of["after"], 2))
    lines: list[str | Table] = [table]
    for pair, before in found.correlation_before.items():
        lines.append(f"correlation of {pair}: {before:.4f} recorded, {found.correlation_after[pair]:.4f} with this motion")
    lines.append(
        f"{seconds:g} s from home to home, within the limits of {plan.name}, free of collisions with no artefact in place; written to {out}"
    )
    then = "let the arm go through it, record its torques as before, then diagnose both", command_line("diagnose", *recordings)
    return Answer({"format": "mbcacq-motion-design/1", "motion": str(out), "std": std, "correlation": correlation}, lines, then)


def _comparison(rows: list[dict[str, Any]]) -> Table:
    table = titled_table("expected and simulated accuracy", "", "given", "designed", left=[""])
    shown = {
        "poses": "calibration poses",
        "expected_bar_mean_mm": "error of certified distances, expected mean, mm",
        "expected_bar_mean_of_calibration_mm": "  of it from the calibration, mm",
        "simulated_bar_mean_mm": "  simulated mean, mm",
        "simulated_standard_error_mm": "    its standard error, mm",
        "simulated_bar_max_mm": "  simulated largest, mm",
        "expected_workspace_mm": "point anywhere in reach, rms, mm",
        **{f"O{k}": f"observability O{k}" for k in range(1, 6)},
    }
    for key, label in shown.items():
        values = [row[key] for row in rows]
        if any(v is not None for v in values):
            table.add_row(label, *("not determined" if v is None else str(v) if isinstance(v, int) else significant(v) for v in values))
    return table
