"""Checks from the first exposure at a station whether the artefact stands where the plan says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mbcacq.acquisition.expected_view import predicted_centres
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.plan import PlannedPose

STAYED = 0.3  # of the distance it should have gone; less is not moved
TOUCHED_MM = 5.0  # nominal arms repeat a place measured from another pose better than this


@dataclass
class PlacementCheck:
    """Remembers where balls were found, in the base frame of the nominal arm.

    tolerance_mm: how far a ball may be from its planned place. known: station -> ball -> (3,) mm, as measured before the run was resumed.
    """

    cell: Cell
    tolerance_mm: float
    known: Mapping[str, Mapping[int, np.ndarray]] = field(default_factory=dict)
    _last: dict[str, tuple[PlannedPose, dict[int, np.ndarray]]] = field(default_factory=dict)

    def fault(self, pose: PlannedPose, q: np.ndarray, ball: np.ndarray, xyz: np.ndarray) -> str:
        """One sentence if the artefact stands elsewhere, else ''. q: (n,) rad; ball: (k,) ids found; xyz: (k, 3) mm, scanner frame."""
        aim = dict(zip(pose.balls, predicted_centres(self.cell, pose), strict=True))
        common = [(b, p, aim[b]) for b, p in zip(ball.tolist(), xyz, strict=True) if b in aim]
        what = f"artefact '{pose.artefact}' at station '{pose.station}'"
        if not common:
            return f"no ball of {what} is where the plan puts it; is it there, and is its side towards the scanner?"
        T_base_scanner = self.cell.robot.chain.flange(q[None])[0] @ self.cell.T_flange_scanner
        found = {b: se3.apply(T_base_scanner, p) for b, p, _ in common}
        away = max(float(np.linalg.norm(p - a)) for _, p, a in common)
        before = self._last.get(pose.artefact)
        if before is not None and before[0].station != pose.station and self._stayed(pose, found, *before):
            return f"{what} was not moved: it still stands where station '{before[0].station}' was"
        if away > self.tolerance_mm:
            return f"{what} stands {away:.0f} mm from where the plan puts it (station_tolerance_mm allows {self.tolerance_mm:g})"
        if touched := self._touched(pose, found):
            return (
                f"{what} stands {touched:.1f} mm from where it stood before the run was interrupted; its poses no longer belong "
                "together: resume with --again"
            )
        self._last[pose.artefact] = pose, found
        return ""

    def _stayed(self, pose: PlannedPose, found: dict[int, np.ndarray], before: PlannedPose, places: dict[int, np.ndarray]) -> bool:
        both = found.keys() & places.keys()
        if not both:
            return False
        planned = self._planned(pose.station, both) - self._planned(before.station, both)
        moved = np.array([found[b] - places[b] for b in sorted(both)])
        should = np.linalg.norm(planned, axis=1).mean()
        return bool(should > 2 * TOUCHED_MM and np.linalg.norm(moved, axis=1).mean() < STAYED * should)

    def _planned(self, station: str, balls: set[int]) -> np.ndarray:
        placed = self.cell.station(station)
        artefact = self.cell.artefact(placed.artefact)
        return se3.apply(placed.planned_pose, artefact.centres[[artefact.ball_ids.index(b) for b in sorted(balls)]])

    def _touched(self, pose: PlannedPose, found: dict[int, np.ndarray]) -> float:
        known = self.known.get(pose.station, {})
        away = [float(np.linalg.norm(p - known[b])) for b, p in found.items() if b in known]
        return max(away) if away and max(away) > TOUCHED_MM else 0.0
