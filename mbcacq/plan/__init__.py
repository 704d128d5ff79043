"""The plan: read, expanded into poses, checked, drawn, timed and improved without opening a socket.

A loaded plan is handed on as :class:`LoadedPlan`, its expansion as a list of :class:`PlannedPose`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbcacq.cell import Cell
from mbcacq.plan.schema import Plan


@dataclass(frozen=True)
class LoadedPlan:
    """A plan with the files it names. cell: robot, artefacts and stations (T_base_station as planned; not for the solver).

    text: the plan's YAML as read. lines: path of a YAML node (('steps', 2, 'views', 0)) -> line, for messages. files: names of the robot
    and artefact files as the plan gives them -> their texts.
    """

    path: Path
    plan: Plan
    cell: Cell
    text: str
    lines: dict[tuple[str | int, ...], int]
    files: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PlannedPose:
    """One pose to take. number: 0.. in running order; q: (n,) rad; balls: certificate ids expected in view; line: in the YAML."""

    number: int
    step: int
    step_name: str
    phase: str
    station: str
    artefact: str
    q: np.ndarray
    balls: tuple[int, ...]
    exposures: int
    line: int


@dataclass(frozen=True)
class Transit:
    """Joint waypoints (n,) rad to pass, in order, before a pose. Where the artefact is moved, that is safe after the first ``leave`` of
    them: the arm then stands at home. Iterates over all of them."""

    leave: list[np.ndarray] = field(default_factory=list)
    approach: list[np.ndarray] = field(default_factory=list)

    def __iter__(self) -> Iterator[np.ndarray]:
        yield from self.leave
        yield from self.approach

    def __len__(self) -> int:
        return len(self.leave) + len(self.approach)


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
    from mbcacq.plan.route import path

    return path(loaded, poses, done)


def refuse_errors(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> None:
    """Raises ConfigError with the first error that ``check`` finds, and how many more there are."""
    from mbcacq.plan.checks import refuse_errors

    refuse_errors(loaded, poses)
