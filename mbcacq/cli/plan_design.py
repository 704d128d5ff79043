"""``mbcacq plan design``: better poses for a plan, or a motion that tells what a recording of torque does not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from mbcacq.cli.next_step import command_line, say_next
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import console as terminal_console
from mbcacq.cli.terminal import echo
from mbcacq.quantities import significant


@click.command("design")
@click.argument("plan", type=PlanPath())
@click.option("--poses", "count", type=click.IntRange(6, 400), help="Number of calibration poses to choose (needed without --motion).")
@click.option(
    "--motion",
    multiple=True,
    type=click.Path(path_type=Path, exists=True),
    metavar="RECORDING",
    help="Design a motion instead that separates masses, a load on the flange and a balancer at A2, beginning with this recording of "
    "torque (a trajectory set or a run; repeatable).",
)
@click.option(
    "--order",
    is_flag=True,
    help="Order the poses instead, those of PLAN and better ones, so that the first few show most: after 24 of them a diagnosis may say "
    "that there is no effect, and a run may stop at any time.",
)
@click.option(
    "--part",
    type=click.Path(path_type=Path),
    is_flag=False,
    flag_value=Path(),
    metavar="[MESH]",
    help="Choose the views of the first `do: scan` step instead, by the surface they show: of MESH (mm, the part's frame), or of the mesh "
    "that the part's file names.",
)
@click.option("--seconds", type=click.FloatRange(5, 120), default=20.0, show_default=True, help="Duration of that motion.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="The new plan [default: NAME_designed.yaml in the folder of PLAN], or the table of the motion [default: NAME_motion.csv].",
)
@click.option(
    "--criterion",
    type=click.Choice(["A", "D"]),
    default="A",
    show_default=True,
    help="A: mean variance of the certified distances; D: volume of the parameters' confidence region.",
)
@click.option("--tilt", type=click.FloatRange(5, 60), default=40.0, show_default=True, help="Steepest view, in °.")
@click.option("--seed", default=0, show_default=True, help="Seed of the random views to choose from, and of the simulated cells.")
@click.option("--force", is_flag=True, help="Replace the file if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def design(
    plan: Path,
    count: int | None,
    motion: tuple[Path, ...],
    order: bool,
    part: Path | None,
    seconds: float,
    out: Path | None,
    criterion: str,
    tilt: float,
    seed: int,
    force: bool,
    as_json: bool,
) -> None:
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
        cover_part(plan, part, out or plan.with_name(f"{plan.stem}_covering.yaml"), tilt, seed, force, as_json)
        return
    if motion:
        design_motion(plan, motion, seconds, out or plan.with_name(f"{plan.stem}_motion.csv"), seed, force, as_json)
        return
    if order:
        order_plan(plan, count, out or plan.with_name(f"{plan.stem}_ordered.yaml"), tilt, seed, force, as_json)
        return
    from mbcacq.design.optimal_design import design
    from mbcacq.design.plan_comparison import compare
    from mbcacq.design.planned_scope import scope_sentence
    from mbcacq.design.station_repair import repaired
    from mbcacq.errors import ConfigError
    from mbcacq.plan import expand, load
    from mbcacq.plan.expansion import expand_reachable

    if count is None:
        raise ConfigError("nothing is asked for; give --poses N for a plan, or --motion RECORDING for a motion")
    target = out or plan.with_name(f"{plan.stem}_designed.yaml")
    refuse_place(plan, target, force)
    loaded, repairs = repaired(load(plan))
    for sentence in repairs:
        echo(sentence, err=True)
    with StepProgress() as steps:
        steps.begin("choosing views by what the calibration learns from them")
        result = design(loaded, count, criterion=criterion, steepest_deg=tilt, seed=seed)
        from mbcacq.files.atomic_write import write_file

        write_file(target, result.text)
        new = load(target)
        poses = expand(new)
        steps.begin("comparing both plans by simulated cells")
        rows = compare([(loaded, expand_reachable(loaded)[0]), (new, poses)], seed)
    if sentence := scope_sentence(new, poses):
        echo(sentence, err=True)
    if as_json:
        how = {"plan": str(target), "tried": result.tried, "criterion": criterion}
        echo(json.dumps({"format": "mbcacq-plan-design/1", **how, "given": rows[0], "designed": rows[1]}))
        return
    _print_comparison(rows)
    echo(f"chosen from {result.tried} views that can be taken; written to {target}")
    say_next("try it without hardware", command_line("run", target, "--dry-run"))


def cover_part(plan: Path, part: Path, out: Path, tilt: float, seed: int, force: bool, as_json: bool) -> None:
    """Choose views of a part, write the plan, and print what they show."""
    from mbcacq.design.part_coverage import design_part
    from mbcacq.files.atomic_write import write_file
    from mbcacq.files.mesh_file import read_mesh
    from mbcacq.plan import expand, load, refuse_errors

    refuse_place(plan, out, force)
    with StepProgress() as steps:
        steps.begin("choosing views by the surface that they show")
        found = design_part(load(plan), None if part == Path() else read_mesh(part), tilt, seed)
        new = load(out, found.text)
        refuse_errors(new, expand(new))
        write_file(out, found.text)
    if as_json:
        figures = {"views": found.views, "covered": found.covered, "visible": found.visible, "tried": found.tried}
        echo(json.dumps({"format": "mbcacq-part-design/1", "plan": str(out), **figures}))
        return
    echo(f"{found.views} views show {found.covered:.1%} of what can be seen of the part; that is {found.visible:.1%} of its surface")
    echo(f"chosen from {found.tried} views that can be taken; written to {out}")
    say_next("try it without hardware", command_line("run", out, "--dry-run"))


def refuse_place(plan: Path, out: Path, force: bool) -> None:
    """Raise ConfigError where a new plan would replace a file, or could not name what PLAN names."""
    from mbcacq.errors import ConfigError

    if out.exists() and not force:
        raise ConfigError(f"{out} exists already; give another --out, or --force to replace it")
    if out.resolve().parent != plan.resolve().parent:
        raise ConfigError(f"{out}: a plan names its robot and artefacts relative to itself; put the new one beside {plan}")


def order_plan(plan: Path, count: int | None, out: Path, tilt: float, seed: int, force: bool, as_json: bool) -> None:
    """Order a plan, write it, and print what its blocks carry."""
    from mbcacq.design.adaptive.plan_order import ordered
    from mbcacq.files.atomic_write import write_file
    from mbcacq.plan import expand, load, refuse_errors

    refuse_place(plan, out, force)
    with StepProgress() as steps:
        steps.begin("leaving out what is missed least, pose by pose")
        found = ordered(load(plan), count, tilt, seed)
        new = load(out, found.text)
        refuse_errors(new, expand(new))
        write_file(out, found.text)
    ends = [sum(found.blocks[: k + 1]) for k in range(len(found.blocks))]
    if as_json:
        shares = dict(zip(map(str, ends), found.shares, strict=True))
        echo(json.dumps({"format": "mbcacq-plan-order/1", "plan": str(out), "tried": found.tried, "share_of_given_after": shares}))
        return
    for end, share in zip(ends, found.shares, strict=True):
        echo(f"after {end:3d} poses: {share:.0%} of what all poses of {plan.name} show")
    echo(f"chosen from {found.tried} poses that can be taken; written to {out}")
    say_next("try it without hardware", command_line("run", out, "--dry-run"))


def design_motion(plan: Path, recordings: tuple[Path, ...], seconds: float, out: Path, seed: int, force: bool, as_json: bool) -> None:
    """Design a motion, write its table, and print what it is expected to tell."""
    from mbcacq.design.excitation import design_excitation
    from mbcacq.errors import ConfigError
    from mbcacq.plan import load
    from mbcacq.workflow.load import load_trajectories

    if out.exists() and not force:
        raise ConfigError(f"{out} exists already; give another --out, or --force to replace it")
    found = design_excitation(load(plan), load_trajectories(*recordings), seconds, seed)
    from mbcacq.files.atomic_write import write_file

    write_file(out, found.table())
    if as_json:
        std = {name: {"before": float(b), "after": float(a)} for name, b, a in zip(found.names, found.before, found.after, strict=True)}
        correlation = {"before": dict(found.correlation_before), "after": dict(found.correlation_after)}
        echo(json.dumps({"format": "mbcacq-motion-design/1", "motion": str(out), "std": std, "correlation": correlation}))
        return
    from rich.table import Table

    table = Table(title="expected standard deviations", title_justify="left")
    for name in ("parameter", "recorded", "with this motion"):
        table.add_column(name, justify="left" if name == "parameter" else "right")
    for name, before, after in zip(found.names, found.before, found.after, strict=True):
        table.add_row(name, significant(before, 2), significant(after, 2))
    terminal_console().print(table)
    for pair, before in found.correlation_before.items():
        echo(f"correlation of {pair}: {before:.4f} recorded, {found.correlation_after[pair]:.4f} with this motion")
    echo(
        f"{seconds:g} s from home to home, within the limits of {plan.name}, free of collisions with no artefact in place; written to {out}"
    )
    say_next("let the arm go through it, record its torques as before, then diagnose both", command_line("diagnose", *recordings))


def _print_comparison(rows: list[dict[str, Any]]) -> None:
    from rich.table import Table

    table = Table(title="expected and simulated accuracy", title_justify="left")
    for name in ("", "given", "designed"):
        table.add_column(name, justify="left" if not name else "right")
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
    terminal_console().print(table)
