"""Options of the commands that move an arm, and who these commands ask and inform: the person at the terminal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mbcacq.cli.terminal import echo

if TYPE_CHECKING:
    from mbcacq.cli.step_progress import StepProgress
    from mbcacq.workflow.run import Operator


@dataclass(frozen=True)
class MotionOptions:
    """dry_run: the fake cell moves. arm: a real arm may move, once that is typed. step: a key before each pose. yes: the positioner's
    prompts are answered with yes. seed: of the fake cell."""

    dry_run: bool
    arm: bool
    step: bool
    yes: bool
    seed: int

    def operator(
        self, steps: StepProgress, began: Callable[[Path], None], artefact_moved: Callable[[str], bool] = lambda station: False
    ) -> Operator:
        """The person at the terminal. steps: shows what takes long. began, artefact_moved: as of an operator."""
        from mbcacq.cli.arming import ask_before_motion
        from mbcacq.cli.progress import RunProgress
        from mbcacq.cli.stepping import KeyPause
        from mbcacq.workflow.run import Operator

        return Operator(
            allow_motion=lambda loaded, poses, sweep: ask_before_motion(loaded, poses, sweep, self.arm),
            artefact_moved=artefact_moved,
            pause=KeyPause() if self.step else None,
            message=lambda sentence: echo(sentence, err=True),
            progress=steps.begin,
            subscribers=(RunProgress(steps.begin),),
            assume_yes=self.yes,
            began=began,
        )

    @property
    def repeated(self) -> list[str]:
        """The options that a command which goes on with an interrupted one repeats."""
        flags = [f"--{name.replace('_', '-')}" for name in ("dry_run", "arm", "step", "yes") if getattr(self, name)]
        return [*flags, *(("--seed", str(self.seed)) if self.seed else ())]


def moves_an_arm(*, confirmed: str = "its speed, workspace and first target are confirmed by typing", drawn: str = "the fake cell") -> Any:
    """Decorator: the command gets ``motion``, the MotionOptions of its options. confirmed: by whom a motion is; drawn: from the seed."""
    options = (
        click.option("--dry-run", is_flag=True, help="Run against the fake cell, which speaks the devices' protocols on this computer."),
        click.option("--arm", is_flag=True, help=f"A real arm may move, once {confirmed}."),
        click.option("--step", is_flag=True, help="Wait for a key before each pose."),
        click.option("--yes", is_flag=True, help="Answer the positioner's prompts with yes (a dry run does)."),
        click.option("--seed", default=0, show_default=True, help=f"Seed of {drawn}."),
    )

    def decorated(function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def with_motion(*args: Any, **given: Any) -> None:
            function(*args, motion=MotionOptions(**{field.name: given.pop(field.name) for field in fields(MotionOptions)}), **given)

        for option in reversed(options):
            with_motion = option(with_motion)
        return with_motion

    return decorated
