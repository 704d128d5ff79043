"""Recordings of motion against a MuJoCo model: what differs is located and named, then fitted in MuJoCo and written into the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.effects.catalogue import declaration
from mbcacq.errors import ConfigError
from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation import parameters
from mbcacq.simulation.model_match import RUNS, TORQUES, ModelCheck, ModelMatch
from mbcacq.simulation.model_residual import along, runs_by_servos
from mbcacq.simulation.mujoco_arm import (
    JOINT_SIDE,
    TORQUE,
    MujocoArm,
    RecordedSignal,
    carried_inertia,
    check_recordings,
    check_sampling,
    gear_spring,
    mujoco_engine,
    remarks_on_masses,
)
from mbcacq.simulation.parameters import Block, pseudo_inertia
from mbcacq.simulation.refinement import ROUNDS, RollOutFit
from mbcacq.simulation.write_model import T_body_link, as_xml

PAYLOAD_SIGMA = 1.0  # prior of an undescribed tool, in logarithms: a factor of e^2 of the mass


def diagnose_against_model(
    trajectories: Sequence[Trajectory], arm: MujocoArm, progress: Callable[[str], None] = lambda text: None, workers: int = 2
) -> tuple[MotionDiagnosis, ModelMatch]:
    """Locate and name the mismatch against MuJoCo's torque along the recorded motion, then fit in MuJoCo what its models can have.

    Raises ConfigError if the recordings are not of the model's arm.
    """
    check_recordings(arm, trajectories)
    if runs_by_servos(arm, trajectories):
        for t in trajectories:
            check_sampling(arm, t)
    progress("MuJoCo follows the recorded motion")
    found = diagnose_trajectories([against_model(t, arm, arm.spec) for t in trajectories])
    fit = RollOutFit(arm, trajectories, workers)
    for effect in found.named_effects:
        if declaration(effect.name).model_block:
            fit.add(_block_of(effect, arm, fit, found), named=True)
    progress("fitting what was found in MuJoCo's own runs" if fit.runs else "fitting what was found to MuJoCo's torques")
    fit.fit(precisely=False)
    for _ in range(ROUNDS):
        more = fit.select(candidates(arm, fit))
        if not more:
            break
        for block in more:
            fit.add(block, named=False)
        progress(f"fitting {', '.join(' '.join(b.key) for b in more)} too")
        fit.fit(precisely=False)
    fit.prune()
    fit.fit()
    progress("comparing with the model found")
    model = fit.model()
    left = diagnose_trajectories([against_model(t, arm, model) for t in trajectories], cross_validation=False)
    changed = tuple(p for block in fit.fitted() for p in block.parameters())
    compared = RUNS if fit.runs else TORQUES
    remarks = (*what_remains(left), *remarks_on_masses(arm, model))
    return found, ModelMatch(
        model=str(arm.path), xml=as_xml(arm, model), parameters=changed, compared=compared, errors=tuple(fit.errors()), remarks=remarks
    )


def check_model(match: ModelMatch, arm: MujocoArm, trajectories: Sequence[Trajectory], name: str) -> ModelMatch:
    """The match with the errors in held-out recordings: of the model as it was given, and of the model found."""
    check_recordings(arm, trajectories)
    fit = RollOutFit(arm, trajectories)
    if fit.runs != (match.compared == RUNS):
        raise ConfigError(f"{name}: has no set points as the recordings diagnosed have; check a recording of the same channels")
    return replace(match, checks=(*match.checks, ModelCheck(name, tuple(fit.errors_of(mujoco_engine().MjSpec.from_string(match.xml))))))


def against_model(t: Trajectory, arm: MujocoArm, spec: Any) -> Trajectory:
    """The recording with what the drives and gears of a model do along the same motion, each as late as its sensor. The set points are left
    to MuJoCo's own servos."""
    every = [RecordedSignal(signal, k) for signal in (TORQUE, JOINT_SIDE) for k in range(arm.n)]
    sensed = along(arm, spec, t, every)
    torque, q_joint = sensed[:, : arm.n], sensed[:, arm.n :]
    robot = replace(arm.robot, gear_ratio=t.robot.gear_ratio, drives=t.robot.drives)
    return replace(t, robot=robot, q_set=None, q_joint=None if t.q_joint is None else t.q_joint - (q_joint - t.q), simulated_torque=torque)


def what_remains(found: MotionDiagnosis) -> tuple[str, ...]:
    """Sentences about what a diagnosis against the model found still names, of what a model has no place for."""
    return tuple(
        f"{effect.name} at {', '.join(effect.where)} remains: a model of this kind has no place for it"
        for effect in found.named_effects
        if not declaration(effect.name).model_block
    )


def _block_of(effect: EffectFound, arm: MujocoArm, fit: RollOutFit, found: MotionDiagnosis) -> Block:
    kind = declaration(effect.name).model_block
    if kind == "inertia":
        return parameters.inertia(arm, _last_body(arm), _with_tool(arm, found), PAYLOAD_SIGMA)
    if kind == "sensor_delay":
        delay = _value(effect, "latency_s")
        block = parameters.sensor_delay(arm, effect.where[0])
        return replace(block, first=np.clip(np.array([delay]), block.lower, block.upper))
    axis = arm.robot.axes.index(effect.where[0])
    torque, speed = _reached(fit)
    if kind == "gear":
        added = _value(effect, f"{effect.where[0]}.compliance_rad_per_Nm")
        return parameters.gear(arm, arm.joints[axis], added, torque[axis])
    block = parameters.friction(arm, arm.joints[axis], torque[axis], speed[axis])
    names = (f"{effect.where[0]}.{name}" for name in ("coulomb_Nm", "viscous_Nms_per_rad"))
    added = [_value(effect, name) if name in effect.parameters else 0.0 for name in names]
    return replace(block, first=np.clip(block.start + added, block.lower, block.upper))


def _value(effect: EffectFound, name: str) -> float:
    """A parameter of one component."""
    (value,), _ = effect.parameters[name].components
    return value


def candidates(arm: MujocoArm, fit: RollOutFit) -> list[Block]:
    """All blocks that a model of this arm can have and the recordings can show, except elastic gears, which a joint-side angle names."""
    torque, speed = _reached(fit)
    carried = carried_inertia(arm)
    out = [parameters.inertia(arm, arm.spec.joint(joint).parent.name) for joint in arm.joints]
    out += [parameters.armature(arm, joint, carried[k]) for k, joint in enumerate(arm.joints)]
    out += [parameters.friction(arm, joint, torque[k], speed[k]) for k, joint in enumerate(arm.joints)]
    out += [parameters.sensor_delay(arm, signal) for signal in sorted({c.signal for c in fit.channels})]
    out += [parameters.gear(arm, joint, 0.0, torque[k]) for k, joint in enumerate(arm.joints) if gear_spring(arm.spec, joint) is not None]
    if fit.runs:
        out += [parameters.servo_gains(arm, joint) for joint in arm.joints]
        out += [parameters.actuator_delay(arm, [joint], joint) for joint in arm.joints]
        out.append(parameters.actuator_delay(arm, arm.joints, "all"))
    return out


def _reached(fit: RollOutFit) -> tuple[np.ndarray, np.ndarray]:
    """Largest torque and speed (n,) of each axis in the recordings."""
    torque, speed = np.ones(fit.arm.n), np.zeros(fit.arm.n)
    for t, data in zip(fit.trajectories, fit.data, strict=True):
        speed = np.maximum(speed, np.abs(np.gradient(t.q, t.time_s, axis=0)).max(axis=0))
        for k, c in enumerate(fit.channels):
            if c.signal == TORQUE:
                torque[c.axis] = max(torque[c.axis], float(np.abs(data[:, k]).max()))
    return torque, speed


def _last_body(arm: MujocoArm) -> str:
    return arm.spec.joint(arm.joints[-1]).parent.name


def _with_tool(arm: MujocoArm, found: MotionDiagnosis) -> np.ndarray | None:
    """(4, 4) pseudo-inertia of the last body with the tool that the diagnosis found, in the body's frame."""
    tool = next((b for b in found.inertial if b.body == "tool"), None)
    if tool is None:
        return None
    xx, xy, xz, yy, yz, zz = tool.tensor_kg_m2
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    S, h = 0.5 * np.trace(tensor) * np.eye(3) - tensor, 1e-3 * np.array(tool.first_moment_kg_mm)
    J = np.block([[S, h[:, None]], [h[None], np.array([[tool.mass_kg]])]])
    T = T_body_link(arm, arm.n - 1)
    T = np.block([[T[:3, :3], 1e-3 * T[:3, 3:]], [T[3:]]])
    out = pseudo_inertia(arm.spec, _last_body(arm)) + T @ J @ T.T
    return out if np.linalg.eigvalsh(out)[0] > 0 else None
