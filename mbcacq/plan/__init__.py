"""The plan: read, expanded into poses, checked, drawn, timed and improved without opening a socket.

A loaded plan is handed on as :class:`LoadedPlan`, its expansion as a list of :class:`PlannedPose`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit

__all__ = ["LoadedPlan", "PlannedPose", "Transit", "expand", "load", "path", "refuse_errors"]


def load(path: str | Path) -> LoadedPlan:
    """Read a plan and the files it names. Raises ConfigError 'file:line: sentence'."""
    from mbcacq.plan.loader import load

    return load(path)


def expand(loaded: LoadedPlan) -> list[PlannedPose]:
    """Every pose of the plan in running order, with joint angles. Raises ConfigError naming step and line of a pose out of reach."""
    from mbcacq.plan.expansion import expand

    return expand(loaded)


def path(loaded: LoadedPlan, poses: Sequence[PlannedPose], done: frozenset[int] = frozenset()) -> list[Transit]:
    """The way to each pose from the one before it (the first: from home), free of collisions as far as the plan knows the cell.

    done: numbers of poses to pass over (a resumed run); their transits are empty, and the ways lead from one of the others to the next.
    Raises ConfigError naming the step of the first pose to which no free way was found.
    """
    from mbcacq.plan.routing import path

    return path(loaded, poses, done)


def refuse_errors(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> None:
    """Raises ConfigError with the first error that ``check`` finds, and how many more there are."""
    from mbcacq.plan.feasibility import refuse_errors

    refuse_errors(loaded, poses)
