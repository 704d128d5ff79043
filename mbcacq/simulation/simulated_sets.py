"""A recording beside the set that another simulator made for the same poses or the same motion.

The difference of both is what is to be explained. So the built-in model takes the other simulator's geometry, and what that simulator
does beyond this geometry is taken off the recording: where both simulators would agree with the recording, nothing is left.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrate import calibrate
from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import predict, residual
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.quantities import DEGREE, in_degrees

SAME_POSE_RAD = 1e-4  # joint angles of the same pose; files keep far more digits
SAME_TIME = 0.01  # of a sampling interval
SAME_MOTION_RAD = 0.05  # by which a simulated servo may follow otherwise than the recorded one


def observations_against(recorded: Observations, simulated: Observations) -> Observations:
    """The recording with the simulated set's geometry as its nominal arm, and without what that set holds beyond its geometry.

    The simulated poses are those of the same joint angles, in any order; poses and balls that it lacks are left out. Raises ConfigError
    where the two are not of the same arm or share no poses, CalibrationError if the simulated set does not determine its geometry.
    """
    pose = _same_poses(recorded, simulated)
    cell = calibrate(simulated, CalibrationOptions(refuse=False))
    beyond = residual(simulated, predict(simulated, cell.state))[:, :3]
    known = {(int(p), int(simulated.cell.ball_ids[b])): -r for p, b, r in zip(simulated.pose, simulated.ball, beyond, strict=True)}
    ids = recorded.cell.ball_ids
    rows = [known.get((int(pose[p]), int(ids[b]))) for p, b in zip(recorded.pose, recorded.ball, strict=True)]
    keep = np.array([r is not None for r in rows], bool)
    if not keep.any():
        raise ConfigError("the simulated set has none of the recorded balls at these poses; simulate the recorded stations and artefacts")
    other = simulated.cell.robot
    robot = replace(recorded.cell.robot, chain=cell.state.chain, mass=other.mass, com=other.com, gravity=other.gravity)
    shift = np.array([r for r in rows if r is not None])
    return replace(_centres(recorded, keep), cell=replace(recorded.cell, robot=robot), xyz=recorded.xyz[keep] - shift)


def _same_poses(recorded: Observations, simulated: Observations) -> np.ndarray:
    """(P,) the simulated pose of each recorded one, -1 where there is none."""
    n, m = recorded.cell.robot.n, simulated.cell.robot.n
    if n != m:
        raise ConfigError(f"the recording has {n} axes, the simulated set {m}; simulate the recorded arm")
    distance = np.abs(recorded.q[:, None] - simulated.q[None]).max(axis=2)
    best = distance.argmin(axis=1)
    same = distance[np.arange(len(best)), best] < SAME_POSE_RAD
    if not same.any():
        k = int(distance.min(axis=1).argmin())
        axis = int(np.abs(recorded.q[k] - simulated.q[best[k]]).argmax())
        name = recorded.cell.robot.axes[axis]
        one, other = (float(in_degrees(v)) for v in (recorded.q[k, axis], simulated.q[best[k], axis]))
        raise ConfigError(
            f"no simulated pose has the joint angles of a recorded one: at the nearest, {name} was recorded at {one:.3f}° and "
            f"simulated at {other:.3f}{_unit_hint(recorded.q, simulated.q)}; simulate the recorded poses"
        )
    return np.where(same, best, -1)


def _unit_hint(recorded: np.ndarray, simulated: np.ndarray) -> str:
    """What is said where one set looks as if its angles were in another unit."""
    ratio = float(np.abs(recorded).max() / max(np.abs(simulated).max(), 1e-12))
    if 0.8 * DEGREE < ratio < 1.25 * DEGREE or 0.8 / DEGREE < ratio < 1.25 / DEGREE:
        return " (as if one of them were in rad: the files hold degrees)"
    return ""


def _centres(obs: Observations, keep: np.ndarray) -> Observations:
    """The observations with these centres (M,) alone."""
    by_centre = {
        name: None if getattr(obs, name) is None else getattr(obs, name)[keep]
        for name in ("pose", "ball", "n_points", "rms_mm", "rotation")
    }
    extra = {k: v[keep] if k.startswith("centres.") else v for k, v in obs.extra.items()}
    return replace(obs, **by_centre, extra=extra)


def trajectory_against(recorded: Trajectory, simulated: Trajectory) -> Trajectory:
    """The recording with the simulated torque beside it; the joint-side angle without the simulated wind-up; and the simulated angle as
    what the recorded one should have followed. Raises ConfigError if both are not of one motion.
    """
    where = recorded.name or "the recording"
    if recorded.robot.n != simulated.robot.n:
        raise ConfigError(f"{where} has {recorded.robot.n} axes, the simulated set {simulated.robot.n}; simulate the recorded arm")
    step, other = (float(np.median(np.diff(t.time_s))) for t in (recorded, simulated))
    begins = simulated.time_s[0] - recorded.time_s[0]
    if len(recorded.time_s) != len(simulated.time_s) or np.abs(recorded.time_s - simulated.time_s).max() > SAME_TIME * step:
        raise ConfigError(
            f"{where} has {len(recorded.time_s)} samples each {1e3 * step:g} ms, the simulated set {len(simulated.time_s)} each "
            f"{1e3 * other:g} ms, beginning {begins:+g} s apart; simulate at the recorded times"
        )
    apart = np.abs(recorded.q - simulated.q).max(axis=0)
    if apart.max() > SAME_MOTION_RAD:
        axis = int(apart.argmax())
        raise ConfigError(
            f"{where}: {recorded.robot.axes[axis]} is up to {in_degrees(apart[axis]):.1f}° from the simulated motion"
            f"{_unit_hint(recorded.q, simulated.q)}; simulate the recorded motion"
        )
    if simulated.torque is None and (recorded.q_joint is None or simulated.q_joint is None) and simulated.q_set is None:
        raise ConfigError(
            "the simulated set has neither torques (tau*_Nm) nor joint-side angles nor set points; let the simulator write them"
        )
    robot = replace(recorded.robot, chain=simulated.robot.chain, mass=simulated.robot.mass, com=simulated.robot.com)
    both = recorded.q_joint is not None and simulated.q_joint is not None
    torque = recorded.torque if simulated.torque is not None else None
    q_joint = np.asarray(recorded.q_joint) - (np.asarray(simulated.q_joint) - simulated.q) if both else None
    q_set = None if simulated.q_set is None or recorded.q_set is None else simulated.q
    own = replace(recorded, robot=robot, torque=torque, simulated_torque=simulated.torque, q_joint=q_joint, q_set=q_set)
    return replace(own, motor_torque=None, current=None)
