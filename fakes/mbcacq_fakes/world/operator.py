"""Who stands where: what an operator or a positioner has put in front of the arm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

NOBODY = -1


@dataclass
class FakeOperator:
    """Follows the plan: the artefact stands at the station of the planned pose whose joints are nearest to the arm's.

    q: (P, n) rad and station: (P,) index, of the planned poses in running order. Mishaps are set from outside.
    wrong: station index -> artefact index standing there instead. covered: ids of balls out of sight. bumps: station index -> (6,) shift
    mm and rotation vector rad of the artefact since it was placed. empty: nothing stands anywhere.
    """

    q: np.ndarray
    station: np.ndarray
    station_artefact: np.ndarray
    wrong: dict[int, int] = field(default_factory=dict)
    covered: set[int] = field(default_factory=set)
    bumps: dict[int, np.ndarray] = field(default_factory=dict)
    empty: bool = False
    fixed: int | None = None
    _last: int = 0

    def station_for(self, q: np.ndarray) -> int:
        """Index of the station served for an arm at q (n,) rad."""
        if self.fixed is not None:
            return self.fixed
        return int(self.station[pose]) if (pose := self.pose_for(q)) != NOBODY else NOBODY

    def pose_for(self, q: np.ndarray) -> int:
        """Index of the planned pose nearest to an arm at q (n,) rad; if several are equally near, the next in running order."""
        if not len(self.q):
            return NOBODY
        away = np.max(np.abs(self.q - q), axis=1)
        nearest = np.flatnonzero(away <= away.min() + 1e-6)
        later = nearest[nearest >= self._last]
        self._last = int(later[0] if len(later) else nearest[0])
        return self._last

    def artefact_at(self, station: int) -> int:
        """Index of the artefact that stands there, NOBODY if none."""
        if self.empty or station == NOBODY:
            return NOBODY
        return self.wrong[station] if station in self.wrong else int(self.station_artefact[station])
