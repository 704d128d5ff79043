"""Where scanner and artefacts are, roughly, from clouds that are already paired with poses; and what every pose would then show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import least_squares

from mbcacq.acquisition.collected.found_cloud import FoundCloud
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.plan import PlannedPose

OUTLIER_MM = 2.0  # from here on a ball counts less: a nominal arm misses by about as much
STATION_MM, STATION_RAD = 30.0, 0.15  # standard deviation of a placement
ROUNDS = 60
STEP = np.sqrt(np.finfo(float).eps)  # of a difference, mm and rad


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
        misses = self._misses(names, pairs)
        found = least_squares(
            lambda state: misses(state[None])[0],
            np.zeros(6 * (1 + len(names))),
            jac=lambda state: _derivatives(misses, state),  # pyright: ignore[reportArgumentType]  # a function is allowed
            loss="soft_l1",
            f_scale=OUTLIER_MM,
            max_nfev=ROUNDS,
            x_scale="jac",
        )
        moves = se3.exp(found.x.reshape(-1, 6))
        self.T_flange_scanner = self.T_flange_scanner @ moves[0]
        self.stations |= {name: self.stations[name] @ move for name, move in zip(names, moves[1:], strict=True)}
        each = self.distances([c for c, _ in pairs])[np.arange(len(pairs)), [p for _, p in pairs]]
        return float(np.median(each))

    def _misses(self, names: Sequence[str], pairs: Sequence[tuple[FoundCloud, int]]) -> Callable[[np.ndarray], np.ndarray]:
        """What (S, 6 (1 + number of names)) twists of the scanner and of the stations of these names, S at once, leave: (S, M) mm, away
        from the balls of the clouds and from where all began.
        """
        place = np.array([names.index(self.poses[p].station) for _, p in pairs])
        flange, stations = self._flange[[p for _, p in pairs]], np.array([self.stations[name] for name in names])
        hand_eye, of_pair, centres, xyz = self.T_flange_scanner, list[int](), list[np.ndarray](), list[np.ndarray]()
        for k, (cloud, pose) in enumerate(pairs):
            artefact = self.cell.artefact(self.cell.station(self.poses[pose].station).artefact)
            centre = dict(zip(artefact.ball_ids, artefact.centres, strict=True))
            for ball, seen in zip(cloud.ball.tolist(), cloud.xyz, strict=True):
                if ball in centre:  # else it is of another artefact than stands there
                    of_pair.append(k)
                    centres.append(centre[ball])
                    xyz.append(seen)
        expected, measured = np.reshape(centres, (-1, 3)), np.reshape(xyz, (-1, 3))

        def misses(states: np.ndarray) -> np.ndarray:
            twists = states.reshape(len(states), -1, 6)
            moves = se3.exp(twists)
            T_scanner_artefact = se3.inverse(flange @ (hand_eye @ moves[:, 0])[:, None]) @ (stations @ moves[:, 1:])[:, place]
            away = se3.apply(T_scanner_artefact[:, of_pair], expected) - measured
            prior = OUTLIER_MM * twists / np.repeat([STATION_MM, STATION_RAD], 3)
            return np.concatenate([away.reshape(len(states), -1), prior.reshape(len(states), -1)], axis=1)

        return misses


def _derivatives(misses: Callable[[np.ndarray], np.ndarray], state: np.ndarray) -> np.ndarray:
    """(M, n) by differences, all of them at once."""
    steps = STEP * np.maximum(1.0, np.abs(state)) * np.where(state < 0, -1.0, 1.0)
    at = misses(np.vstack([state, state + np.diag(steps)]))
    return ((at[1:] - at[0]) / steps[:, None]).T
