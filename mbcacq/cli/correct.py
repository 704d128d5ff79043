"""``mbcacq correct``: joint angles that reach the nominal places with the calibrated arm."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mbcacq
from mbcacq.calibration import result_io
from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.run_path import RunPath, judge_first
from mbcacq.cli.step_progress import StepProgress
from mbcacq.quantities import significant
from mbcacq.workflow import correct, load

MOST_LINES = 20


@subcommand("correct")
def command(
    program: Path = argument(FILE),
    result: Path = option("A result.json, or a run folder that holds one.", RunPath(), "--with", required=True, metavar="RESULT"),
    out: Path | None = option("File to write [default: PROGRAM with _corrected].", FILE),
    force: bool = option("Replace a file that is there."),
    simulated_anyway: bool = option("Also with the calibration of a dry run."),
) -> Answer:
    """Write a copy of PROGRAM whose joint angles bring the calibrated arm, with its effects, to the nominal places.

    PROGRAM: KRL (.src, .dat), URScript (.script), RAPID (.mod), FANUC LS (.ls), or a CSV of joint angles (q1_deg..) or of poses of
    the flange in the base (x_mm, y_mm, z_mm, a_deg, b_deg, c_deg). The command is for controllers without an absolute-accuracy option.
    Only absolute joint targets that the program moves to are changed. Increments, poses, steps and tolerances stay, and are listed with
    the reason, and so are points that cannot be reached. Nobody has run the copy yet: execute it slowly first.

    Example: mbcacq correct weld.dat --with runs/today
    """
    with StepProgress("looking for joint angles that reach the nominal places"):
        done = mbcacq.correct(program, result, out, force=force, simulated_anyway=simulated_anyway)
    warnings = [*result_io.with_warnings(load.as_result(result)), *load.unsealed_note(result)]
    return Answer(done.to_dict(), lines_of(done), judge_first(result), warnings, done.notes)


def lines_of(done: correct.Correction) -> Iterator[str]:
    """What was corrected, what could not be reached, what changes much, and what is left alone."""
    reached = [p for p in done.points if p.reached]
    missed = [p.before_mm for p in done.points if p.before_mm is not None]
    moved = f", which missed their places by up to {max(missed):.3f} mm" if missed else ""
    yield f"{done.file}: {len(reached)} of {len(done.points)} points corrected{moved}"
    if reached:
        yield f"residual of the corrected points by the model: at most {significant(1e3 * max(p.residual_mm for p in reached), 2)} µm"
    for p in [p for p in done.points if not p.reached][:MOST_LINES]:
        yield f"  {_place(p.name, p.line)}: not reached, {significant(p.residual_mm)} mm short: {p.reason}"
    for p in [p for p in done.points if (p.largest_change_deg or 0.0) > correct.LARGE_CHANGE_DEG][:MOST_LINES]:
        yield f"  {_place(p.name, p.line)}: a joint changes by {p.largest_change_deg:.2f}°; look at it before it runs"
    if done.left_alone:
        yield f"{len(done.left_alone)} more {'points are' if len(done.left_alone) > 1 else 'point is'} not corrected:"
    for name, line, reason in done.left_alone[:MOST_LINES]:
        yield f"  {_place(name, line)}: {reason}"
    if len(done.left_alone) > MOST_LINES:
        yield f"  and {len(done.left_alone) - MOST_LINES} more: --json lists all"


def _place(name: str, line: int) -> str:
    """The name of a point and its line; only the line for a point without a name."""
    return name if name == f"line {line}" else f"{name} (line {line})"
