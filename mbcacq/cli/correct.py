"""``mbcacq correct``: joint angles that reach the nominal places with the calibrated arm."""

from __future__ import annotations

import json
from pathlib import Path

import click

from mbcacq.cli.next_step import say_next
from mbcacq.cli.run_path import RunPath, judge_first
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo
from mbcacq.quantities import significant

MOST_LINES = 20


@click.command("correct")
@click.argument("program", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--with", "result", type=RunPath(), required=True, metavar="RESULT", help="A result.json, or a run folder that holds one.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="File to write [default: PROGRAM with _corrected].")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
@click.option("--simulated-anyway", is_flag=True, help="Also with the calibration of a dry run.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def command(program: Path, result: Path, out: Path | None, force: bool, simulated_anyway: bool, as_json: bool) -> None:
    """Write a copy of PROGRAM whose joint angles bring the calibrated arm, with its effects, to the nominal places.

    PROGRAM: KRL (.src, .dat), URScript (.script), RAPID (.mod), FANUC LS (.ls), or a CSV of joint angles (q1_deg..) or of poses of
    the flange in the base (x_mm, y_mm, z_mm, a_deg, b_deg, c_deg). The command is for controllers without an absolute-accuracy option.
    Only absolute joint targets that the program moves to are changed. Increments, poses, steps and tolerances stay, and are listed with
    the reason, and so are points that cannot be reached. Nobody has run the copy yet: execute it slowly first.

    Example: mbcacq correct weld.dat --with runs/today
    """
    import mbcacq
    from mbcacq.calibration.result_io import with_warnings
    from mbcacq.workflow.correct import LARGE_CHANGE_DEG
    from mbcacq.workflow.load import as_result, unsealed_note

    with StepProgress() as steps:
        steps.begin("looking for joint angles that reach the nominal places")
        done = mbcacq.correct(program, result, out, force=force, simulated_anyway=simulated_anyway)
    if as_json:
        echo(json.dumps(done.to_dict()))
        return
    for sentence in [*with_warnings(as_result(result)), *unsealed_note(result)]:
        echo(f"*** {sentence} ***", err=True)
    for note in done.notes:
        echo(f"note: {note}", err=True)
    reached = [p for p in done.points if p.reached]
    missed = [p.before_mm for p in done.points if p.before_mm is not None]
    moved = f", which missed their places by up to {max(missed):.3f} mm" if missed else ""
    echo(f"{done.file}: {len(reached)} of {len(done.points)} points corrected{moved}")
    if reached:
        echo(f"residual of the corrected points by the model: at most {significant(1e3 * max(p.residual_mm for p in reached), 2)} µm")
    for p in [p for p in done.points if not p.reached][:MOST_LINES]:
        echo(f"  {_place(p.name, p.line)}: not reached, {significant(p.residual_mm)} mm short: {p.reason}")
    for p in [p for p in done.points if (p.largest_change_deg or 0.0) > LARGE_CHANGE_DEG][:MOST_LINES]:
        echo(f"  {_place(p.name, p.line)}: a joint changes by {p.largest_change_deg:.2f}°; look at it before it runs")
    if done.left_alone:
        echo(f"{len(done.left_alone)} more {'points are' if len(done.left_alone) > 1 else 'point is'} not corrected:")
    for name, line, reason in done.left_alone[:MOST_LINES]:
        echo(f"  {_place(name, line)}: {reason}")
    if len(done.left_alone) > MOST_LINES:
        echo(f"  and {len(done.left_alone) - MOST_LINES} more: --json lists all")
    say_next(*judge_first(result))


def _place(name: str, line: int) -> str:
    """The name of a point and its line; only the line for a point without a name."""
    return name if name == f"line {line}" else f"{name} (line {line})"
