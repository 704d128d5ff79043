"""What a report needs of the recording itself: residuals of the calibrated cell, and where the arm stood."""

from __future__ import annotations

import numpy as np

from mbcacq.calibration.forward import CellState, arm_jacobian, predict, residual
from mbcacq.observations import Observations
from mbcacq.report.content import Coverage, Residuals


def residuals(observations: Observations, state: CellState, point_mm: np.ndarray | None, joint_rad: np.ndarray | None,
              rejected: set[tuple[int, int | None]] = frozenset()) -> Residuals:
    """Residuals of every centre; the expected sigma is that of scanner noise and joint repeatability together (marginal).

    point_mm: (3,) sigma of a centre; joint_rad: (n,) repeatability of each axis. rejected: (pose number, ball id or None for all).
    """
    obs = observations
    prediction = predict(obs, state)
    left = residual(obs, prediction)[:, :3]
    weighted = None
    if point_mm is not None and joint_rad is not None:
        J = arm_jacobian(obs, prediction, state.chain.joint_twists(prediction.frames))[:, :3]
        sigma = np.sqrt(np.asarray(point_mm) ** 2 + np.sum((J * np.asarray(joint_rad)) ** 2, axis=2))
        weighted = left / sigma
    pose, ball = obs.pose_id[obs.pose], np.array(obs.cell.ball_ids)[obs.ball]
    out = np.array([(int(p), None) in rejected or (int(p), int(b)) in rejected for p, b in zip(pose, ball, strict=True)], dtype=bool)
    return Residuals(pose, ball, _phase(obs)[obs.pose], left, weighted, out)


def coverage(observations: Observations, state: CellState) -> Coverage:
    obs = observations
    return Coverage(np.degrees(obs.q), np.degrees(obs.cell.robot.limits), _phase(obs), state.chain.flange(obs.q)[:, :3, 3])


def calibrated_poses(observations: Observations, result: dict) -> Observations:
    """The poses at stations that the result knows; others (the verification bar) have no place in its forward model."""
    known = {s["id"] for s in result["stations"]}
    station = np.array([s.id in known for s in observations.cell.stations])
    keep = station[observations.station]
    if observations.phase is not None and (observations.phase != "verification").any():
        keep &= observations.phase != "verification"
    return observations.select(keep)


def _phase(obs: Observations) -> np.ndarray:
    return np.full(obs.n_poses, "") if obs.phase is None else obs.phase
