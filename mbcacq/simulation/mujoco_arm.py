"""The arm of a model file in MuJoCo: its axes, gears and servos, the torque along a recorded motion, and new runs from its commands."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model import yaml12
from mbcacq.model.cell import RobotModel
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.robot_import.import_robot import ImportedRobot, import_robot
from mbcacq.model.robot_import.mjcf import is_gear_spring, placeholder_masses, placeholder_remark
from mbcacq.model.trajectory import Trajectory
from mbcacq.quantities import in_degrees

LIMIT_SLACK_RAD = 1e-3  # by which a recorded angle may lie outside the model's range
SETTLING_S = 0.4  # at the first command, before a run that starts at rest
REST_RAD_S = 2e-3
LINEAR = 1  # MuJoCo's interpolation of a delayed signal between its samples
LONGEST_DELAY_S = 0.05
DEFLECTION_ROUNDS = 3  # of the quasi-static wind-up of gears along a recorded motion
ENCODER, TORQUE, JOINT_SIDE = "q", "tau", "q_joint"
UNITS = {ENCODER: "rad", TORQUE: "N m", JOINT_SIDE: "rad"}


def mujoco_engine() -> Any:
    """The package mujoco, which is slow to load."""
    return import_module("mujoco")


@dataclass(frozen=True)
class RecordedSignal:
    """One recorded signal of one axis. signal: 'q' (motor-side angle), 'tau' (torque of the drive) or 'q_joint' (joint-side angle)."""

    signal: str
    axis: int

    @property
    def name(self) -> str:
        return f"A{self.axis + 1} {self.signal}"


@dataclass(frozen=True, eq=False)
class MujocoArm:
    """An arm as a model of MuJoCo.

    Attributes
    ----------
    spec : Any
        The model, mujoco.MjSpec.
    joints : tuple[str, ...]
        Its hinges, axis 1 first.
    robot : RobotModel
        The same arm as this program describes it.
    imported : ImportedRobot
        How its rows were made.
    servos : tuple[int, ...] or None
        The number of the position servo of each axis, None if an axis has none.
    """

    path: Path
    spec: Any
    joints: tuple[str, ...]
    robot: RobotModel
    imported: ImportedRobot
    servos: tuple[int, ...] | None

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def timestep_s(self) -> float:
        return float(self.spec.option.timestep)


def load_arm(path: Path | str) -> MujocoArm:
    """Raises ConfigError if MuJoCo is missing, cannot read the file, or no serial arm of named hinges is in it."""
    path, engine = Path(path), mujoco_engine()
    imported = import_robot(path)
    robot = RobotSpec.model_validate(yaml12.load(imported.text)).model()
    try:
        spec = engine.MjSpec.from_file(str(path))
        spec.compiler.fusestatic = False  # of a URDF, links on fixed joints are to stay bodies of their own
        model = spec.compile()
    except (ValueError, OSError) as error:
        raise ConfigError(f"{path}: MuJoCo cannot read it: {str(error).splitlines()[0]}; correct the file") from None
    missing = [robot.axes[k] for k, name in enumerate(imported.joints) if not name or spec.joint(name) is None]
    if missing:
        raise ConfigError(f"{path}: the joint of {missing[0]} is without a name; name all joints of the arm")
    _resolve_frames(spec, model, imported.joints)
    return MujocoArm(path, spec, imported.joints, robot, imported, _servos(engine, spec, model, imported.joints))


def base_body(arm: MujocoArm, model: Any) -> int:
    """Number of the body that is the base of the imported arm. MuJoCo makes the root link of a URDF one with the world."""
    found = mujoco_engine().mj_name2id(model, mujoco_engine().mjtObj.mjOBJ_BODY, arm.imported.base)
    return max(found, 0)


def _resolve_frames(spec: Any, model: Any, joints: tuple[str, ...]) -> None:
    """Place the arm's bodies and hinges in their bodies themselves, as MuJoCo compiles them, where the file has <frame> around them. The
    compiler then does not move values that are written into a place or an axis later."""
    bodies = [spec.joint(name).parent for name in joints]
    placed = [(body, body.id) for body in bodies if body.frame is not None]  # the first change takes all numbers away
    turning = [(hinge, hinge.id) for body in bodies for hinge in body.joints if hinge.frame is not None]
    for body, number in placed:
        body.pos, body.quat = model.body_pos[number], model.body_quat[number]
        body.alt.type = mujoco_engine().mjtOrientation.mjORIENTATION_QUAT
        body.set_frame(body.parent.add_frame())
    for hinge, number in turning:
        hinge.axis, hinge.pos = model.jnt_axis[number], model.jnt_pos[number]
        hinge.set_frame(hinge.parent.add_frame())


def _servos(engine: Any, spec: Any, model: Any, joints: tuple[str, ...]) -> tuple[int, ...] | None:
    """Actuators that follow a commanded angle: a force of gain * command + bias with a bias against the angle, on the joint itself."""
    out = []
    for name in joints:
        joint = model.joint(name).id
        found = [
            a
            for a in range(model.nu)
            if model.actuator_trntype[a] == engine.mjtTrn.mjTRN_JOINT
            and model.actuator_trnid[a, 0] == joint
            and model.actuator_biastype[a] == engine.mjtBias.mjBIAS_AFFINE
            and model.actuator_biasprm[a, 1] < 0
        ]
        out += found[:1]
    return tuple(out) if len(out) == len(joints) else None


def gear_spring(spec: Any, joint: str) -> Any | None:
    """The spring hinge of the gear of a joint, None for a rigid gear."""
    engine, own = mujoco_engine(), spec.joint(joint)
    model = spec.compile()
    springs = [j for j in own.parent.joints if j.name != joint and is_gear_spring(engine, model, model.joint(j.name).id)]
    return springs[0] if springs else None


def gear_springs(arm: MujocoArm, spec: Any) -> tuple[list[int], list[str]]:
    """The axes whose gears have springs, and the names of these."""
    found = [(k, s.name) for k, name in enumerate(arm.joints) if (s := gear_spring(spec, name)) is not None]
    return [k for k, _ in found], [name for _, name in found]


def remarks_on_masses(arm: MujocoArm, spec: Any) -> tuple[str, ...]:
    """A sentence where masses of a model of the arm are placeholders, as those of an exported calibration are."""
    model = spec.compile()
    invented = placeholder_masses(mujoco_engine(), model, [model.joint(name).id for name in arm.joints])
    return (f"in {arm.path.name} {placeholder_remark(invented)}",) if invented else ()


def check_recordings(arm: MujocoArm, trajectories: Sequence[Trajectory]) -> None:
    """Raises ConfigError if a recording cannot be of the model's arm."""
    for t in trajectories:
        where = t.name or "the recording"
        if t.robot.n != arm.n:
            names = ", ".join(arm.joints)
            raise ConfigError(f"{where} has {t.robot.n} axes, {arm.path} has {arm.n} ({names}); give the model of the recorded arm")
        model = arm.spec.compile()
        for k, name in enumerate(arm.joints):
            joint = model.joint(name)
            low, high = (float(v) for v in joint.range)
            least, most = float(np.min(t.q[:, k])), float(np.max(t.q[:, k]))
            if joint.limited and (least < low - LIMIT_SLACK_RAD or most > high + LIMIT_SLACK_RAD):
                span = f"{in_degrees(least):.1f} to {in_degrees(most):.1f}°"
                limits = f"{in_degrees(low):.1f} to {in_degrees(high):.1f}"
                raise ConfigError(
                    f"{where}: {arm.robot.axes[k]} was recorded from {span}, joint '{name}' of {arm.path} turns {limits}; the units, the "
                    "order of the joints, or their zeros and directions differ: correct the recording or the model"
                )


# the torque along a recorded motion


def torque_along(
    arm: MujocoArm, spec: Any, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, step_s: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Torque (T, n) N m that the drives of a model exert in MuJoCo along a motion of the motor-side angles q, qd, qdd (T, n). Also the
    wind-up (T, n) rad of the gears, each at its equilibrium. Contacts and joint limits take no part. step_s: sampling interval; None for
    postures that are no motion."""
    engine = mujoco_engine()
    model = spec.compile()
    model.opt.disableflags |= int(engine.mjtDisableBit.mjDSBL_CONTACT) | int(engine.mjtDisableBit.mjDSBL_LIMIT)
    data = engine.MjData(model)
    position, dof = addresses(model, arm.joints)
    which, springs = gear_springs(arm, spec)
    windup = np.zeros_like(q)
    spring_position, spring_dof = addresses(model, springs)
    stiffness = np.array([np.atleast_1d(spec.joint(name).stiffness)[0] for name in springs])
    rest = np.array(model.qpos0)
    torque = np.zeros_like(q)
    for _ in range(DEFLECTION_ROUNDS if springs else 1):
        speed = np.gradient(windup, step_s, axis=0) if springs and step_s else np.zeros_like(q)
        rate = np.gradient(speed, step_s, axis=0) if springs and step_s else np.zeros_like(q)
        force = np.zeros((len(q), model.nv))
        for i in range(len(q)):
            data.qpos[:] = rest
            data.qpos[position], data.qvel[dof], data.qacc[dof] = q[i], qd[i], qdd[i]
            if springs:
                data.qpos[spring_position] = rest[spring_position] + windup[i, which]
                data.qvel[spring_dof], data.qacc[spring_dof] = speed[i, which], rate[i, which]
            engine.mj_inverse(model, data)
            force[i] = data.qfrc_inverse
        torque = force[:, dof]
        if springs:
            windup[:, which] -= force[:, spring_dof] / stiffness
    return torque, windup


def addresses(model: Any, joints: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Where the joints stand in qpos and in qvel."""
    ids = [model.joint(name).id for name in joints]
    return np.array([model.jnt_qposadr[j] for j in ids], int), np.array([model.jnt_dofadr[j] for j in ids], int)


def body_of(model: Any, joint: str) -> int:
    """Number of the body that a joint moves."""
    return int(model.jnt_bodyid[model.joint(joint).id])


def frames_at(model: Any, bodies: Sequence[int], joints: Sequence[str], q: np.ndarray) -> np.ndarray:
    """(P, B, 4, 4) mm: bodies of a model in the world, with joints at q (P, k) rad and all others where the model has them at first."""
    engine, at, out = mujoco_engine(), addresses(model, joints)[0], []
    data = engine.MjData(model)
    for row in q:
        data.qpos[at] = row
        engine.mj_kinematics(model, data)
        out.append([se3.transform(data.xmat[b].reshape(3, 3), 1e3 * data.xpos[b]) for b in bodies])
    return np.array(out)


def carried_inertia(arm: MujocoArm) -> np.ndarray:
    """(n,) kg m^2 that each joint turns, in the model's own first posture, rotor included."""
    engine = mujoco_engine()
    model = arm.spec.compile()
    data = engine.MjData(model)
    engine.mj_forward(model, data)
    out = []
    for joint in arm.joints:
        alone, product = np.zeros(model.nv), np.zeros(model.nv)
        alone[int(model.jnt_dofadr[model.joint(joint).id])] = 1.0
        engine.mj_mulM(model, data, product, alone)
        out.append(float(alone @ product))
    return np.array(out)


# new runs


def with_sensors(arm: MujocoArm, spec: Any, joint_side: bool) -> None:
    """Give the model a sensor of each channel that it lacks: the angle and the actuator's torque of each joint, and the joint-side angle
    where that was recorded."""
    engine = mujoco_engine()
    kinds = engine.mjtSensor
    hinge = engine.mjtObj.mjOBJ_JOINT
    named = {s.name for s in spec.sensors}
    for joint in arm.joints:
        for kind, name in ((kinds.mjSENS_JOINTPOS, f"{joint}_angle"), (kinds.mjSENS_JOINTACTFRC, f"{joint}_torque")):
            if not any(s.type == kind and s.objname == joint and not _of_joint_side(s) for s in spec.sensors):
                spec.add_sensor(name=name, type=kind, objtype=hinge, objname=joint)
        if joint_side and f"{joint}_joint_side" not in named:
            spec.add_sensor(name=f"{joint}_joint_side", type=kinds.mjSENS_JOINTPOS, objtype=hinge, objname=joint)
        gear = gear_spring(spec, joint)
        if joint_side and gear is not None and f"{gear.name}_joint_side" not in named:
            spec.add_sensor(name=f"{gear.name}_joint_side", type=kinds.mjSENS_JOINTPOS, objtype=hinge, objname=gear.name)


def _of_joint_side(sensor: Any) -> bool:
    return sensor.name.endswith("_joint_side")


def sensors_of(spec: Any, channel: str, joint: str) -> list[Any]:
    """The sensors whose sum is a channel of a joint."""
    kinds = mujoco_engine().mjtSensor
    if channel == TORQUE:
        return [s for s in spec.sensors if s.type == kinds.mjSENS_JOINTACTFRC and s.objname == joint][:1]
    if channel == ENCODER:
        return [s for s in spec.sensors if s.type == kinds.mjSENS_JOINTPOS and s.objname == joint and not _of_joint_side(s)][:1]
    siblings = {j.name for j in spec.joint(joint).parent.joints}
    return [s for s in spec.sensors if s.type == kinds.mjSENS_JOINTPOS and s.objname in siblings and _of_joint_side(s)]


def channels_of(arm: MujocoArm, trajectories: Sequence[Trajectory]) -> list[RecordedSignal]:
    """What all of the recordings have."""
    names = {ENCODER: "q", TORQUE: "torque", JOINT_SIDE: "q_joint"}
    return [
        RecordedSignal(signal, k)
        for signal, name in names.items()
        for k in range(arm.n)
        if all((values := getattr(t, name)) is not None and np.isfinite(values[:, k]).all() for t in trajectories)
    ]


def recorded(t: Trajectory, channels: Sequence[RecordedSignal]) -> np.ndarray:
    """(T, C) what was recorded."""
    signals = {ENCODER: t.q, TORQUE: t.torque, JOINT_SIDE: t.q_joint}
    return np.stack([np.asarray(signals[c.signal])[:, c.axis] for c in channels], axis=1)


def check_sampling(arm: MujocoArm, t: Trajectory) -> int:
    """Steps of the model in one sample. Raises ConfigError if the recording has no even sampling that the model's timestep divides."""
    step, where = float(np.median(np.diff(t.time_s))), t.name or "the recording"
    if np.abs(np.diff(t.time_s) - step).max() > 0.01 * step:
        raise ConfigError(f"{where}: the samples are not evenly spaced in time; resample the recording, or give its controller's cycles")
    ratio = step / arm.timestep_s
    if ratio < 0.99 or abs(ratio - round(ratio)) > 0.01:
        raise ConfigError(
            f"{where}: a sample each {1e3 * step:g} ms is no multiple of the timestep of {arm.path}, {1e3 * arm.timestep_s:g} ms; "
            "set the model's timestep to a whole fraction of it"
        )
    return round(ratio)


def roll_out(arm: MujocoArm, specs: Sequence[Any], t: Trajectory, channels: Sequence[RecordedSignal], workers: int = 2) -> np.ndarray:
    """(B, T, C) what the sensors of each model give when its servos get the recorded set points. A run from rest is settled first.

    Raises ConfigError for a recording without set points, or of another sampling.
    """
    if t.q_set is None or not np.isfinite(t.q_set).all() or arm.servos is None:
        raise ConfigError(f"{t.name or 'the recording'}: a new run needs the set points of all axes (q*_set_deg) and a servo for each")
    per_sample = check_sampling(arm, t)
    samples = np.arange(len(t.q))
    fine = np.arange((len(t.q) - 1) * per_sample + 1) / per_sample
    command = CubicSpline(samples, t.q_set)(fine)
    start = np.asarray(np.gradient(t.q[: min(len(t.q), 25)], float(np.median(np.diff(t.time_s))), axis=0)).mean(axis=0)
    resting = bool(np.abs(start).max() < REST_RAD_S)
    settle = int(SETTLING_S / arm.timestep_s) if resting else 0
    command = np.concatenate([np.repeat(command[:1], settle, axis=0), command])
    begin = t.q[:10].mean(axis=0) if resting else t.q[0]
    speed = np.zeros(arm.n) if resting else start

    def one(spec: Any) -> np.ndarray:
        return _run(arm, spec, begin, speed, command, channels)[settle::per_sample][: len(t.q)]

    with ThreadPoolExecutor(workers) as pool:
        return np.stack(list(pool.map(one, specs)))


def _run(arm: MujocoArm, spec: Any, q: np.ndarray, qd: np.ndarray, command: np.ndarray, channels: Sequence[RecordedSignal]) -> np.ndarray:
    """(S, C) the channels at every step."""
    rollout: Any = import_module("mujoco.rollout")
    engine = mujoco_engine()
    model = spec.compile()
    data = engine.MjData(model)
    position, dof = addresses(model, arm.joints)
    data.qpos[position], data.qvel[dof] = q, qd
    full = engine.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(engine.mj_stateSize(model, full))
    engine.mj_getState(model, data, state, full)
    control = np.zeros((len(command), model.nu))
    control[:, list(arm.servos or ())] = command
    _, sensed = rollout.rollout(model, data, state[None], control[None])
    out = np.zeros((len(command), len(channels)))
    for k, channel in enumerate(channels):
        for sensor in sensors_of(spec, channel.signal, arm.joints[channel.axis]):
            out[:, k] += sensed[0][:, model.sensor_adr[sensor.id]]
    return out
