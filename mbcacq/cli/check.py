"""``mbcacq check``: a few poses repeated, and whether anything changed."""

from __future__ import annotations

from pathlib import Path

import mbcacq
from mbcacq.cli.declared import FILE, Answer, argument, option, subcommand
from mbcacq.cli.next_step import forget_failure
from mbcacq.cli.operator import MotionOptions
from mbcacq.cli.plan_path import PlanPath
from mbcacq.cli.run_path import RunPath
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.step_progress import StepProgress
from mbcacq.interim_check import words
from mbcacq.quantities import capitalised


@subcommand("check")
def command(
    result: Path = argument(RunPath()),
    plan: Path = argument(PlanPath()),
    history: Path | None = option("File of all checks [default: check.json beside RESULT].", FILE),
    measured: Path | None = option("Judge a check that was measured already; nothing moves.", RunPath("check"), "--from", metavar="RUN"),
    poses: int = option("Number of poses, chosen at the first check.", default=12),
    placed_anew: bool = option("The artefact is placed anew for each check, so its place is not judged."),
    part: bool = option("Judge by the scans of PLAN's part instead of balls [always without balls]."),
    out: Path | None = option("Folder of the recording [default: runs/TIME_check-NAME]."),
    motion: MotionOptions = MotionOptions,  # type: ignore[assignment]
) -> Answer:
    """Repeat the few poses of PLAN that show most of what may have changed since RESULT: mastering, tool, mount, links, gears.

    The poses are chosen at the first check. Each later check repeats them, and all are judged together: what changed, where, since when.
    However many checks are made, there are false alarms in fewer than one of a hundred arms. The exit code is 0 if the cell is as before,
    and 11 if it changed.

    \b
    Examples:
      mbcacq check runs/latest kuka --dry-run
      mbcacq check calibrated/result.json my-cell.yaml --arm
    """
    end_in_order_on_signals()
    steps = StepProgress()
    operator = motion.operator(steps, "where all poses were measured, judge them", "check", result, plan, "--from")
    loaded = mbcacq.load_plan(plan)
    settings = mbcacq.CheckSettings(poses, not placed_anew, folder=out, part=part)
    with steps:
        done = mbcacq.check(
            result,
            loaded,
            history=history,
            measured=measured,
            dry_run=motion.dry_run,
            seed=motion.seed,
            operator=operator,
            settings=settings,
        )
    forget_failure()
    return Answer(done.to_dict(), lines_of(done), done.next_step(result, plan, motion.dry_run), end=done.refuse_changed)


def lines_of(done: mbcacq.InterimCheck) -> list[str]:
    """What a person reads: the verdict, the evidence, the suspects, and what would have been noticed."""
    v, days = done.verdict, len(done.history.days)
    out = [f"{capitalised(done.sentence)}."]
    since, before, alarm = (words.odds(value) for value in (v.log_e, v.log_e_calibration, v.log_threshold))
    out.append(f"evidence for a change since the first check {since}, since the calibration {before}; alarm at {alarm}")
    off = sum(one.end - one.first for one in v.put_right)
    count = f"checks: {days}{f', {off} of them while the cell was off' if off else ''}, of {len(done.history.poses)} poses each"
    drift = f"changes from day to day are {v.day:g} times the usual" if v.day else "no changes from day to day"
    out.append(f"{count}; the noise is {v.noise:g} times that of the calibration, {drift}")
    out += [f"  {s.label}: probability {s.probability:.2f}" + (f"; {size}" if (size := words.size_of(s)) else "") for s in v.suspects]
    if not done.changed and days > 1:
        out.append("noticed within a week, nine times of ten:")
        out += [f"  {name} ({where}): {words.size_in_words(size, 0.0, unit)}" for name, where, size, unit in v.noticed]
    page = [f"page: {done.page}"] if done.run.is_dir() else []
    return [*out, f"recording: {done.run}", f"history: {done.file}", *page]
