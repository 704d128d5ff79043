"""Recorded poses against a MuJoCo model: the model's geometry is what is diagnosed, and what was found is written into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.effects.catalogue import declaration
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.cell import RobotModel
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.quantities import in_degrees
from mbcacq.simulation import parameters
from mbcacq.simulation.model_match import ChannelError, ModelMatch, ModelParameter
from mbcacq.simulation.mujoco_arm import MujocoArm, base_body, body_of, check_recordings, frames_at, gear_spring, gear_springs, torque_along
from mbcacq.simulation.write_model import T_body_link, as_xml, body_frames, with_chain

POSES = "poses"


def observations_of_model(recorded: Observations, arm: MujocoArm) -> Observations:
    """The recording with the model's arm as its nominal one; where the model has elastic gears, at the joint angles behind them.

    Raises ConfigError if the model has another number of axes or turns less far.
    """
    robot = recorded.cell.robot
    if robot.n != arm.n:
        raise ConfigError(f"the recording has {robot.n} axes, {arm.path} has {arm.n}; give the model of the recorded arm")
    check_recordings(arm, [Trajectory(arm.robot, np.arange(len(recorded.q), dtype=float), recorded.q)])
    given, base = arm.imported.T_flange_given, se3.inverse(arm.imported.T_given_base)
    own = replace(arm.robot, payload_mass=robot.payload_mass, payload_com=se3.apply(given, robot.payload_com), drives=robot.drives)
    mass = arm.robot.mass if arm.robot.mass.any() else robot.mass
    own = replace(own, repeatability_mm=robot.repeatability_mm, gear_ratio=robot.gear_ratio, mass=mass)
    stations = tuple(s if s.T_base_station is None else replace(s, T_base_station=base @ s.T_base_station) for s in recorded.cell.stations)
    cell = replace(recorded.cell, robot=own, T_flange_scanner=given @ recorded.cell.T_flange_scanner, stations=stations)
    return replace(recorded, cell=cell, q=recorded.q + windup(arm, arm.spec, recorded.q))


def windup(arm: MujocoArm, spec: Any, q: np.ndarray) -> np.ndarray:
    """(P, n) rad by which the gears of a model wind up under gravity."""
    still = np.zeros_like(q)
    return torque_along(arm, spec, q, still, still, None)[1] if gear_springs(arm, spec)[0] else still


def is_written(name: str) -> bool:
    """Whether a model can hold an effect of poses beside its geometry: the compliance of a gear."""
    return declaration(name).model_block == "gear"


def write_into_model(arm: MujocoArm, found: CalibratedCell, effects: Sequence[EffectFound]) -> ModelMatch:
    """The model with the calibrated chain and the compliances of the cell. found: of observations that ``observations_of_model`` gave, with
    the effects that a model can hold; effects: all that the diagnosis named."""
    spec = with_chain(arm, found.state.chain)
    robot = found.fit.observations.cell.robot
    if robot.payload_mass > 0:
        _add_payload(arm, spec, robot)
    changed = _moved_bodies(arm, spec)
    for term in () if found.effects is None else found.effects.terms:
        joint = arm.joints[term.parts[0].index]
        old = gear_spring(arm.spec, joint)
        before = 0.0 if old is None else 1.0 / float(np.atleast_1d(old.stiffness)[0])
        total, std = before + float(term.coefficients[0]), float(term.std[0])
        if total > 0:
            block = parameters.gear(arm, joint, total, 1.0)
            block.prepare(spec)
            block.apply(spec, np.array([total, parameters.GEAR_DAMPING_S]))
            stiffness = (np.inf if before == 0 else 1 / before, 1 / total, std / total**2)
            changed.append(ModelParameter("gear", joint, "stiffness_Nm_per_rad", *stiffness, float("nan"), named=True))
    remarks = [
        f"{e.name} at {', '.join(e.where)} has no counterpart in a model and is not written" for e in effects if not is_written(e.name)
    ]
    distance = miss(arm, spec, found)
    error = ChannelError("MuJoCo's model against the calibrated cell at the recorded poses, at most", "mm", 0.0, float("nan"), distance)
    return ModelMatch(
        model=str(arm.path), xml=as_xml(arm, spec), parameters=tuple(changed), compared=POSES, errors=(error,), remarks=tuple(remarks)
    )


def _moved_bodies(arm: MujocoArm, spec: Any) -> list[ModelParameter]:
    """Places and turns of the bodies, each against the one before."""
    out = []
    for joint in arm.joints:
        old, new = arm.spec.joint(joint).parent, spec.joint(joint).parent
        for k, axis in enumerate("xyz"):
            values = 1e3 * float(old.pos[k]), 1e3 * float(new.pos[k])
            out.append(ModelParameter("place", new.name, f"pos_{axis}_mm", *values, float("nan"), float("nan"), named=True))
        turn = _turn(old.quat, new.quat)
        out.append(ModelParameter("place", new.name, "turned_deg", 0.0, float(in_degrees(turn)), float("nan"), float("nan"), named=True))
    return out


def _turn(one: np.ndarray, other: np.ndarray) -> float:
    return 2 * float(np.arccos(min(1.0, abs(float(np.dot(one / np.linalg.norm(one), other / np.linalg.norm(other)))))))


def _add_payload(arm: MujocoArm, spec: Any, robot: RobotModel) -> None:
    """The tool that the recording declares, as a body of the model: its weight winds up the gears."""
    place = se3.apply(T_body_link(arm, arm.n - 1), robot.payload_com)
    parent = spec.joint(arm.joints[-1]).parent
    if parent.find_child("payload") is None:
        body = parent.add_body(name="payload", pos=1e-3 * np.asarray(place))
        body.explicitinertial = True
        body.mass, body.ipos, body.inertia = robot.payload_mass, np.zeros(3), np.full(3, 1e-3 * robot.payload_mass)


def miss(arm: MujocoArm, spec: Any, found: CalibratedCell) -> float:
    """Largest distance (mm) of the last body's origin in MuJoCo's model from the calibrated cell's, at the poses of the recording."""
    obs = found.fit.observations
    motor = obs.q - windup(arm, arm.spec, obs.q)  # behind elastic gears the recording stands where they leave it
    chain, effects = found.state.chain, found.effects
    frames = chain.frames(obs.q) if not effects else effects.frames(chain, obs.q, obs)
    last = body_frames(arm, arm.spec)[-1]
    nominal = arm.imported.T_given_base @ arm.robot.chain.frames(np.zeros((1, arm.n)))[0][-1]
    expected = arm.imported.T_given_base @ frames[:, -1] @ np.linalg.inv(nominal) @ last
    made = run_poses(arm, spec, motor)
    return float(np.linalg.norm(made[:, :3, 3] - expected[:, :3, 3], axis=1).max())


def run_poses(arm: MujocoArm, spec: Any, q: np.ndarray) -> np.ndarray:
    """(P, 4, 4) mm: the last body of a model at motor-side angles q (P, n), gears wound up by gravity, in the base of the imported arm."""
    model = spec.compile()
    axes, springs = gear_springs(arm, spec)
    at = np.concatenate([q, windup(arm, spec, q)[:, axes]], axis=1)
    frames = frames_at(model, (base_body(arm, model), body_of(model, arm.joints[-1])), [*arm.joints, *springs], at)
    return np.linalg.inv(frames[:, 0]) @ frames[:, 1]
