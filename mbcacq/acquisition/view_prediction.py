"""Prediction of the ball centres of a pose from the earlier poses, with its uncertainty: an iterated extended Kalman filter.

The state is a twist of the hand-eye and one of the station, both relative to the plan. The error of the nominal arm is a twist of the
scanner that every pose draws anew; it is never learnt.
"""

from __future__ import annotations

import numpy as np

from mbcacq.acquisition.gate_options import GateOptions
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.plan import PlannedPose

ITERATIONS = 3  # of the linearisation: a placement is off by degrees
STEP = 1e-6  # of the numerical derivative, mm and rad


class ViewPrediction:
    """Estimates hand-eye and station from the poses so far."""

    def __init__(self, cell: Cell, station_tolerance_mm: float, options: GateOptions) -> None:
        o, self._cell, self._options = options, cell, options
        station_mm = o.station_share * station_tolerance_mm
        mount, station = (np.repeat([mm, rad], 3) ** 2 for mm, rad in ((o.mount_mm, o.mount_rad), (station_mm, o.station_rad)))
        self._station_variance = station
        self._state = np.zeros(12)
        self._covariance = np.diag(np.concatenate([mount, station]))

    def new_station(self) -> None:
        """Forget the station; what is known of the hand-eye stays."""
        self._state[6:] = 0.0
        self._covariance[6:] = self._covariance[:, 6:] = 0.0
        self._covariance[6:, 6:] = np.diag(self._station_variance)

    def deviation(self, pose: PlannedPose, ball: np.ndarray, xyz: np.ndarray) -> tuple[float, float]:
        """The ball farthest from its prediction: how many standard uncertainties, and how many mm. ball: (k,) ids; xyz: (k, 3) mm."""
        if len(ball) == 0:
            return 0.0, 0.0
        expected, H = self._linearised(pose, ball, self._state)
        S = H @ self._covariance @ H.T + self._measurement_covariance(expected)
        away = xyz - expected
        blocks = np.array([S[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(ball))])
        sigmas = np.sqrt(np.einsum("ki,ki->k", away, np.linalg.solve(blocks, away[..., None])[..., 0]))
        worst = int(np.argmax(sigmas))
        return float(sigmas[worst]), float(np.linalg.norm(away[worst]))

    def learn(self, pose: PlannedPose, ball: np.ndarray, xyz: np.ndarray) -> None:
        """Update hand-eye and station by the centres of an accepted pose."""
        before, P = self._state, self._covariance
        state, gain, H = before, np.zeros((12, 3 * len(ball))), np.zeros((3 * len(ball), 12))
        for _ in range(ITERATIONS if len(ball) else 0):
            expected, H = self._linearised(pose, ball, state)
            S = H @ P @ H.T + self._measurement_covariance(expected)
            gain = np.linalg.solve(S, H @ P).T
            state = before + gain @ ((xyz - expected).reshape(-1) - H @ (before - state))
        covariance = P - gain @ H @ P
        self._state, self._covariance = state, (covariance + covariance.T) / 2

    def _linearised(self, pose: PlannedPose, ball: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres (k, 3) mm in the scanner frame, and their derivative (3 k, 12) by the state."""
        artefact = self._cell.artefact(pose.artefact)
        centres = artefact.centres[[artefact.ball_ids.index(b) for b in ball.tolist()]]
        T_base_flange = self._cell.robot.chain.flange(pose.q[None])[0]
        T_base_station = self._cell.station(pose.station).planned_pose

        beside = state + STEP * np.concatenate([np.zeros((1, 12)), np.eye(12), -np.eye(12)])  # all at once: a call costs more than its sums
        T_base_scanner = T_base_flange @ self._cell.T_flange_scanner @ se3.exp(beside[:, :6])
        T_scanner_artefact = se3.inverse(T_base_scanner) @ T_base_station @ se3.exp(beside[:, 6:])
        seen = se3.apply(T_scanner_artefact[:, None], centres)
        return seen[0], ((seen[1:13] - seen[13:]) / (2 * STEP)).reshape(12, -1).T

    def _measurement_covariance(self, expected: np.ndarray) -> np.ndarray:
        """(3 k, 3 k) mm^2: the arm moves all balls of a pose together, the rest moves each by itself."""
        o, k = self._options, len(expected)
        A = np.concatenate([np.tile(np.eye(3), (k, 1, 1)), -np.array([se3.skew(p) for p in expected])], axis=2).reshape(-1, 6)
        arm = A * np.repeat([o.arm_mm, o.arm_rad], 3)
        return arm @ arm.T + o.centre_mm**2 * np.eye(3 * k)
