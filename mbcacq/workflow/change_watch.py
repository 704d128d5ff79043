"""While a run goes on: after each station, whether something changed since the run began, said to the operator at once."""

from __future__ import annotations

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.calibration.calibrate import changed_while_recorded
from mbcacq.calibration.change_found import ChangeFound
from mbcacq.model.cell import Cell
from mbcacq.model.observations import Observations

LEAST_POSES = 12  # before a first look
MOST_POSES = 600  # whose adjustment takes about a second, while the arm rests
SAME_POSES = 2  # a change at nearly the same moment was said already


class ChangeWatch:
    """A subscriber that collects the poses of a run and looks for a change whenever the next station is reached.

    The arm stays as it is described, with link errors at random: few poses suffice for that. What is said is a warning of the run, in its
    recording too. The calibration of the whole run decides.
    """

    def __init__(self, cell: Cell, bus: EventBus) -> None:
        self._cell, self._bus = cell, bus
        self._poses: list[events.PoseDone] = []
        self._said: list[ChangeFound] = []

    def __call__(self, event: events.Event) -> None:
        """Take what a run tells of itself."""
        if isinstance(event, events.PoseDone) and len(event.ball):  # a sweep's balls are found at the end
            self._poses.append(event)
        elif isinstance(event, events.StationReached) and LEAST_POSES <= len(self._poses) <= MOST_POSES:
            self._look()

    def _look(self) -> None:
        change = changed_while_recorded(observations_of(self._cell, self._poses))
        if change is None or any(abs(change.nth - one.nth) <= SAME_POSES for one in self._said):
            return
        self._said.append(change)
        self._bus.message("warning", f"something changed while this run was measured: {change.event}")


def observations_of(cell: Cell, poses: list[events.PoseDone]) -> Observations:
    """Poses of a run as observations of a cell."""
    station = {s.id: k for k, s in enumerate(cell.stations)}
    ball = {number: k for k, number in enumerate(cell.ball_ids)}
    count = [len(p.ball) for p in poses]
    return Observations(
        cell,
        np.array([p.pose for p in poses]),
        np.array([station[p.station] for p in poses]),
        np.array([p.q for p in poses]),
        np.repeat(np.arange(len(poses)), count),
        np.array([ball[int(number)] for p in poses for number in p.ball], dtype=int),
        np.concatenate([p.xyz for p in poses]),
        phase=np.array([p.phase for p in poses]),
        time_s=np.array([p.time_s for p in poses]),
    )
