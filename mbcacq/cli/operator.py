"""Who a command that moves an arm asks and informs: the terminal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from mbcacq.cli.terminal import echo

if TYPE_CHECKING:
    from mbcacq.cli.step_progress import StepProgress
    from mbcacq.workflow.run import Operator


def operator_at_terminal(
    steps: StepProgress,
    *,
    arm: bool,
    step: bool,
    yes: bool,
    began: Callable[[Path], None],
    artefact_moved: Callable[[str], bool] = lambda station: False,
) -> Operator:
    """The person at the terminal. steps: shows what takes long. arm: a real arm may move, once that is typed; step: a key before each pose;
    yes: the positioner's prompts are answered with yes. began, artefact_moved: as of an operator.
    """
    from mbcacq.cli.arming import ask_before_motion
    from mbcacq.cli.progress import RunProgress
    from mbcacq.cli.stepping import KeyPause
    from mbcacq.workflow.run import Operator

    return Operator(
        allow_motion=lambda loaded, poses, sweep: ask_before_motion(loaded, poses, sweep, arm),
        artefact_moved=artefact_moved,
        pause=KeyPause() if step else None,
        message=lambda sentence: echo(sentence, err=True),
        progress=steps.begin,
        subscribers=(RunProgress(steps.begin),),
        assume_yes=yes,
        began=began,
    )


def as_before(*, dry_run: bool, seed: int, arm: bool, step: bool, yes: bool) -> list[str]:
    """The options that a command which goes on with an interrupted one repeats."""
    given = [word for word, set_ in (("--dry-run", dry_run), ("--arm", arm), ("--step", step), ("--yes", yes)) if set_]
    return [*given, *(("--seed", str(seed)) if seed else ())]
