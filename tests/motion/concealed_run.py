"""A run of a heavy arm that conceals a tool, a balancer, elastic joints and backlash, in its poses and in the motion between them."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from mbcacq_fakes.dynamics.online import MovingArm, description

from mbcacq.challenge.simulated_cells import observe
from mbcacq.geometry.gravity import gravity_torque, upright_angle
from mbcacq.model.cell import RobotModel
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory, moves
from mbcacq.plan import LoadedPlan, PlannedPose

DECLARED_KG, DECLARED_COM_MM = 20.0, np.array([0.0, 0.0, 60.0])
FURTHER_COM_MM = np.array([20.0, -10.0, 80.0])  # of what hangs on the flange and is not declared
SOFT = {"A2": 5e-7, "A3": 1e-6}  # rad/(N m)
WIDTH_DEG = 0.006  # backlash of A4
BALANCER_SHARE, LEVER_RATIO, STIFFENS = 0.4, 0.25, 0.8  # of the largest gravity torque of A2; lever over column; over its stroke
CYCLE_S = 0.012  # of the controller
REST_S, LEAST_MOVE_S, LAG_S = 0.3, 0.5, 0.02

Faults = list[dict[str, Any]]


def tool(further_kg: float) -> tuple[float, np.ndarray]:
    """Mass in kg and centre of gravity (3,) mm of all that hangs on the flange."""
    total = DECLARED_KG + further_kg
    return total, (DECLARED_KG * DECLARED_COM_MM + further_kg * FURTHER_COM_MM) / total


def spring_of(robot: RobotModel) -> list[float]:
    """The balancer of the moving arm: sign, ratio, stiffness (N m), length at rest and upright angle (rad), as the arm at rest has it."""
    q = np.zeros((361, robot.n))
    q[:, 1] = np.linspace(-np.pi, np.pi, len(q))
    frames = robot.chain.frames(q)
    load = gravity_torque(robot.chain, frames, robot.mass, robot.com, DECLARED_KG, DECLARED_COM_MM, robot.gravity)[:, 1]
    up = upright_angle(robot.chain, robot.gravity)
    assert up is not None, "the second axis lies level"
    end = LEVER_RATIO * np.stack([np.sin(q[:, 1] - up), np.cos(q[:, 1] - up)], axis=1)
    rod = np.array([0.0, 1.0]) - end
    length = np.linalg.norm(rod, axis=1)
    force = 1 + STIFFENS * (length - (1 - LEVER_RATIO)) / (2 * LEVER_RATIO)
    pull = (force / length)[:, None] * rod
    torque = np.abs(end[:, 0] * pull[:, 1] - end[:, 1] * pull[:, 0])
    largest = BALANCER_SHARE * np.abs(load).max() / torque.max()
    stiffness = float(STIFFENS * largest / (2 * LEVER_RATIO))
    return [-1.0, LEVER_RATIO, stiffness, (1 - LEVER_RATIO) - 2 * LEVER_RATIO / STIFFENS, float(up + np.pi / 2)]


def chosen_poses(poses: Sequence[PlannedPose], seed: int, count: int, narrow: Sequence[str]) -> tuple[list[PlannedPose], list[PlannedPose]]:
    """Some poses of the calibration, drawn at random in their order, and those of them that stand at the stations ``narrow``."""
    usable = [pose for pose in poses if pose.phase != "verification"]
    drawn = sorted(np.random.default_rng([seed, 99]).choice(len(usable), count, replace=False))
    chosen = [usable[i] for i in drawn]
    return chosen, [pose for pose in chosen if str(pose.station) in narrow]


def faults(robot: RobotModel, further_kg: float, in_poses_kg: float | None = None) -> tuple[Faults, Faults]:
    """What is concealed from the scanner, and from the drives. in_poses_kg: the further load at rest, where it is not that in motion."""
    total, com = tool(further_kg if in_poses_kg is None else in_poses_kg)
    soft = [{"name": "joint_compliance", "where": at, "compliance_rad_per_Nm": c} for at, c in SOFT.items()]
    balancer = {"name": "gravity_compensator", "compliance_rad_per_Nm": SOFT["A2"], "share": BALANCER_SHARE, "lever_ratio": LEVER_RATIO}
    play = {"name": "backlash", "where": "A4", "width_deg": WIDTH_DEG}
    # At rest the balancer brings the elasticity of its joint with it.
    at_rest = [balancer, {"name": "payload", "mass_kg": total, "com_mm": com.tolist(), "compliance_rad_per_Nm": 0}, soft[1], play]
    moving = [
        {"name": "gravity_compensator", "spring": spring_of(robot)},
        {"name": "payload", "mass_kg": further_kg, "com_mm": FURTHER_COM_MM.tolist()},
        *soft,
        play,
        *({"name": "friction", "where": f"A{j + 1}", "kind": "plain"} for j in range(robot.n)),
    ]
    return at_rest, moving


def observed_poses(loaded: LoadedPlan, poses: Sequence[PlannedPose], at_rest: Faults, seed: int) -> Observations:
    """What a run would record at its poses, without protocols and pictures."""
    return observe(loaded, poses, SimpleNamespace(seed=seed, outliers=0.0, missing=()), at_rest)[0]


def recorded_moves(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], moving: Faults, seed: int, speed_share: float = 0.2
) -> list[Trajectory]:
    """What the fake controller's arm would send of the moves from one pose to the next, at a share of the speed limits."""
    robot, q = loaded.cell.robot, np.array([pose.q for pose in poses])
    fastest = speed_share * (np.radians(150.0) * np.ones(robot.n) if robot.speed is None else np.asarray(robot.speed))
    path = np.concatenate([_move(one, other, fastest) for one, other in zip(q[:-1], q[1:], strict=True)])
    arm = MovingArm(np.degrees(path[0]).tolist(), CYCLE_S, LAG_S, description(robot, moving, seed))
    rows = []
    for set_point in np.degrees(path):
        arm.step(tuple(set_point))
        rows.append((np.radians(arm.q), np.radians(arm.joint_deg), arm.torque))
    angle, joint, torque = (np.array(column) for column in zip(*rows, strict=True))
    time = CYCLE_S * np.arange(len(angle))
    return moves(Trajectory(robot, time, angle, q_joint=joint, torque=torque))


def _move(one: np.ndarray, other: np.ndarray, fastest: np.ndarray) -> np.ndarray:
    """(T, n) set points from rest to rest, with a pause behind, of least jerk."""
    seconds = max(1.875 * float(np.max(np.abs(other - one) / fastest)), LEAST_MOVE_S)
    share = np.clip(np.arange(0.0, seconds + REST_S, CYCLE_S) / seconds, 0.0, 1.0)[:, None]
    return one + share**3 * (10 - 15 * share + 6 * share**2) * (other - one)
