"""Where scanner and artefacts are, roughly, from clouds that are already paired with poses; and what every pose would then show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from mbcacq.acquisition.collected.found_cloud import FoundCloud
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.plan import PlannedPose

OUTLIER_MM = 2.0  # from here on a ball counts less: a nominal arm misses by about as much
STATION_MM, STATION_RAD = 30.0, 0.15  # standard deviation of a placement
ROUNDS = 60


class PlacementFit:
    """Hand-eye transform and stations of one session, first as planned, then as the pairs so far say."""

    def __init__(self, cell: Cell, poses: Sequence[PlannedPose], T_flange_scanner: np.ndarray | None = None) -> None:
        self.cell, self.poses = cell, list(poses)
        self.T_flange_scanner = cell.T_flange_scanner if T_flange_scanner is None else T_flange_scanner
        self.stations = {s.id: s.planned_pose for s in cell.stations if any(p.station == s.id for p in poses)}
        self._flange = cell.robot.chain.flange(np.array([p.q for p in poses]))
        self._ids = list(cell.ball_ids)
        self._column = {ball: k for k, ball in enumerate(self._ids)}

    def predicted(self, T_flange_scanner: np.ndarray | None = None, stations: dict[str, np.ndarray] | None = None) -> np.ndarray:
        """(P, K, 3) mm, scanner frame: every ball of the cell at every pose; NaN for those of other artefacts."""
        hand_eye = self.T_flange_scanner if T_flange_scanner is None else T_flange_scanner
        stations = self.stations if stations is None else stations
        T_scanner_base = se3.inverse(self._flange @ hand_eye)
        out = np.full((len(self.poses), len(self._ids), 3), np.nan)
        for station, T_base_station in stations.items():
            rows = [k for k, pose in enumerate(self.poses) if pose.station == station]
            artefact = self.cell.artefact(self.cell.station(station).artefact)
            columns = [self._column[ball] for ball in artefact.ball_ids]
            out[np.ix_(rows, columns)] = se3.apply((T_scanner_base[rows] @ T_base_station)[:, None], artefact.centres)
        return out

    def distances(self, clouds: Sequence[FoundCloud]) -> np.ndarray:
        """(C, P) mm: root mean square between the balls of each cloud and where each pose would show them; inf where none is common, NaN
        for a cloud that does not say what it shows."""
        expected = self.predicted()
        out = np.full((len(clouds), len(self.poses)), np.nan)
        for c, cloud in enumerate(clouds):
            if not cloud.identified:
                continue
            columns = [self._column[ball] for ball in cloud.ball.tolist()]
            away = np.sum((expected[:, columns] - cloud.xyz) ** 2, axis=2)
            known = np.isfinite(away).sum(axis=1)
            out[c] = np.sqrt(np.where(known > 0, np.nansum(away, axis=1) / np.maximum(known, 1), np.inf))
        return out

    def fit(self, clouds: Sequence[FoundCloud], pose: Sequence[int | None]) -> float:
        """Move scanner and stations to where the pairs put them. pose: index into ``poses`` of each cloud, or None. Returns the median
        distance (mm) of a cloud after it."""
        pairs = [(c, p) for c, p in zip(clouds, pose, strict=True) if p is not None and c.identified]
        if not pairs:
            return np.inf
        paired = {self.poses[p].station for _, p in pairs}
        names = [name for name in self.stations if name in paired]
        rows = np.concatenate([np.full(len(c.ball), p) for c, p in pairs])
        columns = np.concatenate([[self._column[b] for b in c.ball.tolist()] for c, _ in pairs]).astype(int)
        xyz = np.concatenate([c.xyz for c, _ in pairs])
        start_hand_eye, start = self.T_flange_scanner, dict(self.stations)

        def placed(state: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
            twists = state.reshape(-1, 6)
            return start_hand_eye @ se3.exp(twists[0]), {s: start[s] @ se3.exp(t) for s, t in zip(names, twists[1:], strict=True)}

        def miss(state: np.ndarray) -> np.ndarray:
            away = self.predicted(*placed(state))[rows, columns] - xyz
            prior = OUTLIER_MM * state.reshape(-1, 6) / np.repeat([STATION_MM, STATION_RAD], 3)
            return np.concatenate([np.nan_to_num(away, nan=0.0).ravel(), prior.ravel()])

        found = least_squares(miss, np.zeros(6 * (1 + len(names))), loss="soft_l1", f_scale=OUTLIER_MM, max_nfev=ROUNDS, x_scale="jac")
        self.T_flange_scanner, learnt = placed(found.x)
        self.stations |= learnt
        each = self.distances([c for c, _ in pairs])[np.arange(len(pairs)), [p for _, p in pairs]]
        return float(np.median(each))
