"""A robot program of a plan's poses, for an arm that is not driven from here."""

from __future__ import annotations

import hashlib
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.plan import LoadedPlan, expand, refuse_errors
from mbcacq.plan.programs import Trigger, motion_program, written
from mbcacq.workflow.acquire import plan_acquisition
from mbcacq.workflow.load import as_plan

DIGITS = 12


def plan_digest(loaded: LoadedPlan) -> str:
    """Short name of what a plan and the files that it names say, comments included."""
    whole = hashlib.sha256(loaded.text.encode())
    for name, text in sorted(loaded.files.items()):
        whole.update(name.encode() + b"\0" + text.encode())
    return whole.hexdigest()[:DIGITS]


def robot_program(
    plan: LoadedPlan | Path | str, dialect: str, *, trigger: Trigger | None = None, done: frozenset[int] = frozenset()
) -> dict[str, str]:
    """The files of a program in the language of a controller (``mbcacq.plan.programs.DIALECTS``): name -> text.

    It goes through the poses that are not ``done`` by the routes that a run would take, each checked as before a run, and waits at each
    for its exposures. Raises ConfigError and SafetyStop as ``run`` does.
    """
    loaded = as_plan(plan)
    poses = expand(loaded)
    refuse_errors(loaded, poses)
    if swept := next((pose for pose in poses if pose.sweep is not None), None):
        raise ConfigError(f"step '{swept.step_name}' sweeps a line scanner, which a program cannot start and stop; run such a plan instead")
    if done and all(pose.number in done for pose in poses):
        raise ConfigError(f"all {len(poses)} poses are measured already; there is nothing left for a program to do")
    checked = plan_acquisition(loaded, poses, done, 0, "")
    program = motion_program(loaded, poses, checked.paths, checked.path_home, plan_digest(loaded), trigger=trigger, done=done)
    return written(loaded, program, dialect)
