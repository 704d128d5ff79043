"""What stands between the command line and a real arm: --arm, and a sentence that is typed."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

import click

from mbcacq.cli.terminal import echo
from mbcacq.devices.addresses import on_loopback_only
from mbcacq.errors import Aborted, ConfigError
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.motion_limits import T1_MM_S
from mbcacq.plan.motion_preview import Swept


def ask_before_motion(loaded: LoadedPlan, poses: Sequence[PlannedPose], sweep: Swept, arm: bool) -> None:
    """The last gate before a real arm moves, and before its drives are switched on. Raises ConfigError without --arm or without a terminal,
    Aborted where the operator does not type what is asked for. A fake on this computer's loopback is not asked about, unless --arm says
    that something real is behind it (a tunnel)."""
    use = loaded.plan.robot
    if on_loopback_only(use.options) and not arm:
        return
    name = loaded.cell.robot.name
    if not arm:
        raise ConfigError(
            f"this would move {name}: {len(poses)} poses, the scanner at up to {sweep.speed_mm_s:.0f} mm/s; "
            "if that is meant, say so with --arm (--dry-run takes the fake cell)"
        )
    if not sys.stdin.isatty():
        raise ConfigError(f"moving {name} must be confirmed by typing, but standard input is not a terminal; run it in a terminal")
    for line in description(loaded, poses, sweep):
        echo(line, err=True)
    sentence = f"move {len(poses)}"
    try:
        answer = click.prompt(
            f"Type '{sentence}' to let it move, anything else to end", prompt_suffix=": ", default="", show_default=False, err=True
        )
    except click.Abort:
        answer = ""
    if answer.strip().lower() != sentence:
        raise Aborted("the operator did not allow the robot to move")


def description(loaded: LoadedPlan, poses: Sequence[PlannedPose], sweep: Swept) -> Iterator[str]:
    """What the operator has to know before the arm moves, a line each."""

    use, robot = loaded.plan.robot, loaded.cell.robot
    box = ", ".join(f"{axis} {low:.0f}..{high:.0f}" for axis, low, high in zip("xyz", sweep.low, sweep.high, strict=True))
    space = loaded.plan.workspace
    fence = (
        "the plan sets no limits (workspace)"
        if space is None
        else "kept within "
        + ", ".join(f"{axis} {low:g}..{high:g}" for axis, low, high in zip("xyz", space.min_mm, space.max_mm, strict=True))
    )
    places = ", ".join(f"{key} {value}" for key, value in use.options.items() if isinstance(value, str) and value)
    yield f"{robot.name} (driver {use.driver}{', ' + places if places else ''}) is going to move:"
    yield f"  poses      {len(poses)}, in {sweep.segments} motions"
    yield f"  speed      {100 * use.speed:g} % of the axes' largest speeds; the scanner up to {sweep.speed_mm_s:.0f} mm/s"
    yield f"  workspace  {box} mm in the base frame, swept by flange and scanner; {fence}"
    yield f"  first      straight from where it stands to home, {robot.in_words(use.home)}"
    yield f"  then       pose {poses[0].number} at station {poses[0].station}, {robot.in_words(poses[0].q)}"
    t1 = use.speed * T1_MM_S / sweep.speed_mm_s if sweep.speed_mm_s > T1_MM_S else None
    slower = f", with robot: speed {t1:.2g} to stay below {T1_MM_S:g} mm/s" if t1 else ""
    yield f"For a first run of a plan: operating mode T1{slower}, a hand on the enabling switch, and --step."
    yield "Is the cell clear, and the stop button at hand?"
