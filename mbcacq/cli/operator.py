"""Options of the commands that move an arm, and who these commands ask and inform: the person at the terminal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mbcacq
from mbcacq.cli import arming, progress, stepping
from mbcacq.cli.declared import option
from mbcacq.cli.next_step import command_line, on_failure
from mbcacq.cli.step_progress import StepProgress
from mbcacq.cli.terminal import echo


@dataclass(frozen=True)
class MotionOptions:
    """Options of a command that moves an arm."""

    dry_run: bool = option("Run against the fake cell, which speaks the devices' protocols on this computer.")
    arm: bool = option("A real arm may move, once its speed, workspace and first target are confirmed by typing.")
    step: bool = option("Wait for a key before each pose.")
    yes: bool = option("Answer the positioner's prompts with yes (a dry run does).")
    seed: int = option("Seed of the fake cell, and of the views that an investigation chooses from.", default=0)

    def operator(
        self, steps: StepProgress, why: str, *words: object, artefact_moved: Callable[[str], bool] = lambda station: False
    ) -> mbcacq.Operator:
        """The person at the terminal. steps: shows what takes long. why, words: what an interrupted run is gone on with, and the command
        but for its last word, the folder. artefact_moved: as of an operator."""
        return mbcacq.Operator(
            allow_motion=lambda loaded, poses, sweep: arming.ask_before_motion(loaded, poses, sweep, self.arm),
            artefact_moved=artefact_moved,
            pause=stepping.KeyPause() if self.step else None,
            message=lambda sentence: echo(sentence, err=True),
            progress=steps.begin,
            subscribers=(progress.RunProgress(steps.begin),),
            assume_yes=self.yes,
            began=lambda folder: on_failure(why, command_line(*words, folder), folder / "run.rrd"),
        )

    @property
    def repeated(self) -> list[str]:
        """The options that a command which goes on with an interrupted one repeats."""
        flags = [f"--{name.replace('_', '-')}" for name in ("dry_run", "arm", "step", "yes") if getattr(self, name)]
        return [*flags, *(("--seed", str(self.seed)) if self.seed else ())]
