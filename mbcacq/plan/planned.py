"""A plan as it is handed on: loaded with the files it names, and expanded into poses and the transits between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.model.cell import Cell
from mbcacq.model.computed_once import ComputedOnce
from mbcacq.plan.limits import PlanningLimits
from mbcacq.plan.schema import Plan


@dataclass(frozen=True)
class LoadedPlan:
    """A plan with the files it names.

    Attributes
    ----------
    path
        The file.
    plan
        The plan as data.
    cell
        Robot, artefacts and stations (T_base_station as planned; not for the solver).
    text
        The YAML text as read.
    lines
        Path of a YAML node (('steps', 2, 'views', 0)) -> line, for messages.
    files
        Names of the robot and artefact files as the plan gives them -> their texts.
    planning
        Numbers that tune its checks and routes.
    grown_from
        Number of poses that the plan of a run had before others were added to it; None for a plan as its author wrote it.
    """

    path: Path
    plan: Plan
    cell: Cell
    text: str
    lines: dict[tuple[str | int, ...], int]
    files: dict[str, str] = field(default_factory=dict)
    planning: PlanningLimits = PlanningLimits()
    grown_from: int | None = None
    computed: ComputedOnce = field(default_factory=ComputedOnce, init=False, repr=False, compare=False)  # what follows from it

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "computed": ComputedOnce()}  # another process computes it anew


@dataclass(frozen=True)
class PlannedPose:
    """One pose to take. number: 0.. in running order; q: (n,) rad; balls: certificate ids expected in view; line: in the YAML; sweep: (n,)
    rad, to which the arm moves and comes back while it is measured, None: it stands."""

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
    sweep: np.ndarray | None = None


@dataclass(frozen=True)
class Transit:
    """Joint waypoints (n,) rad to pass, in order, before a pose. Iterates over all of them.

    retract: away from the pose before; where the station changes it ends at home, and the artefact may then be moved.
    approach: the rest, up to the pose itself, which is not among them.
    """

    retract: list[np.ndarray] = field(default_factory=list)
    approach: list[np.ndarray] = field(default_factory=list)

    def __iter__(self) -> Iterator[np.ndarray]:
        yield from self.retract
        yield from self.approach

    def __len__(self) -> int:
        return len(self.retract) + len(self.approach)
