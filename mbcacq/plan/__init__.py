"""The plan: read, expanded into poses, checked, drawn, timed and improved without opening a socket.

A loaded plan is handed on as :class:`LoadedPlan`, its expansion as a list of :class:`PlannedPose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.cell import Cell
from mbcacq.plan.schema import Plan


@dataclass(frozen=True)
class LoadedPlan:
    """A plan with the files it names. cell: robot, artefacts and stations (T_base_station as planned; not for the solver).

    text: the plan's YAML as read. lines: path of a YAML node (('steps', 2, 'views', 0)) -> line, for messages.
    """

    path: Path
    plan: Plan
    cell: Cell
    text: str
    lines: dict[tuple[str | int, ...], int]


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
