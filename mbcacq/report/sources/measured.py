"""Residuals of the calibrated cell, coverage of the workspace and quality of the sphere fits, computed from the observations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.calibration.result_io import effects_of
from mbcacq.estimation.forward_model import CellState, predict, residual
from mbcacq.estimation.terms import accumulate, known_errors
from mbcacq.geometry import se3
from mbcacq.geometry.link_shapes import arm_outline, link_radii
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations
from mbcacq.report.content import Coverage, Residuals, Spheres


def residuals(observations: Observations, result: Mapping[str, Any], state: CellState) -> Residuals:
    """Residuals of every centre at the stations that the result knows, with its effects and the errors of its instrument; the expected
    sigma is that of scanner noise and joint repeatability together (marginal). state: the cell of the result, as the observations list it.
    """
    obs, effects, noise = calibrated_poses(observations, result), effects_of(result), result["noise"]
    known = [*zip(effects.at(obs), effects.coefficients, strict=True)] if effects else []
    known += known_errors(obs, {p["name"]: p["value"] for p in result["parameters"]})
    prediction = predict(obs, state, accumulate(obs, *zip(*known, strict=True)) if known else None)
    deviation = residual(obs, prediction)[:, :3]
    J = prediction.by_twists(state.chain.joint_twists(prediction.frames))[:, :3]
    repeated = np.sum((J * np.asarray(noise["joint_rad"])) ** 2, axis=2)
    sigma = np.sqrt(np.asarray(noise["scanner_mm"])[: deviation.shape[1]] ** 2 + repeated)
    robot, rejected = obs.cell.robot, {(r["pose"], r.get("ball")) for r in result.get("rejected", ())}
    pose, ball = obs.pose_id[obs.pose], np.array(obs.cell.ball_ids)[obs.ball]
    out = np.array([(int(p), None) in rejected or (int(p), int(b)) in rejected for p, b in zip(pose, ball, strict=True)], dtype=bool)
    station = np.array([s.id for s in obs.cell.stations])[obs.station][obs.pose]
    return Residuals(
        pose=pose,
        ball=ball,
        phase=_phase(obs)[obs.pose],
        xyz=_three(deviation),
        weighted=_three(deviation / sigma),
        outlier=out,
        station=station,
        q_deg=None if robot.of_flange_poses else robot.drawn(obs.q)[obs.pose],
        axes=robot.drawn_axes,
    )


def _three(rows: np.ndarray) -> np.ndarray:
    """Rows (M, 3) of residuals; those of a distance are along x."""
    return np.pad(rows, ((0, 0), (0, 3 - rows.shape[1])))


def coverage(observations: Observations, state: CellState) -> Coverage:
    obs = observations
    T = state.chain.flange(obs.q)
    balls, phase = None, None
    if obs.cell.measurement != TARGET_IN_BASE and obs.n_centres and not obs.cell.robot.of_flange_poses:  # one target is one place
        balls, phase = se3.apply((T @ state.T_flange_scanner)[obs.pose], obs.xyz), _phase(obs)[obs.pose]
    return Coverage(
        q_deg=None if obs.cell.robot.of_flange_poses else obs.cell.robot.drawn(obs.q),
        limits_deg=obs.cell.robot.drawn(obs.cell.robot.limits.T).T,
        axes=obs.cell.robot.drawn_axes,
        phase=_phase(obs),
        flange=T[:, :3, 3],
        balls=balls,
        ball_phase=phase,
        arm=_arm(obs, state),
        arm_radii=None if obs.cell.robot.of_flange_poses else link_radii(state.chain),
    )


def _arm(obs: Observations, state: CellState) -> np.ndarray | None:
    """(3 n, 3) mm: the links in the pose in the middle of the run, to draw the arm by; None of poses of a flange."""
    if not obs.n_poses or obs.cell.robot.of_flange_poses:
        return None
    return arm_outline(state.chain, obs.q[obs.n_poses // 2], of_foot=True)


def spheres(observations: Observations) -> Spheres | None:
    """None if the observations carry no quality of their fits."""
    obs = observations
    if obs.rms_mm is None or obs.n_points is None or not obs.n_centres or not np.any(np.isfinite(obs.rms_mm)):
        return None
    ball = np.array(obs.cell.ball_ids)[obs.ball]
    return Spheres(obs.pose_id[obs.pose], ball, np.asarray(obs.n_points, dtype=float), 1e3 * np.asarray(obs.rms_mm, dtype=float))


def calibrated_poses(observations: Observations, result: Mapping[str, Any]) -> Observations:
    """The poses at stations that the result knows; its forward model does not hold the others (the verification bar)."""
    known = {s["id"] for s in result["stations"]}
    station = np.array([s.id in known for s in observations.cell.stations])
    keep = station[observations.station]
    if observations.phase is not None and (observations.phase != "verification").any():
        keep &= observations.phase != "verification"
    return observations.select(keep)


def _phase(obs: Observations) -> np.ndarray:
    return np.full(obs.n_poses, "") if obs.phase is None else obs.phase
