"""What a recording can change in a MuJoCo model, in blocks: friction, rotors, gears, inertias, delays, servo gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.simulation.mujoco_arm import LINEAR, LONGEST_DELAY_S, MujocoArm, carried_inertia, gear_spring, mujoco_engine, sensors_of

Values = dict[str, float]
RELATIVE_STEP = 1e-3  # of a finite difference, against the size of a coordinate
DELAY_STEP = 1.5  # timesteps: MuJoCo takes a delay below one as one
GEAR_DAMPING_S = 1e-3  # first guess of a gear's damping, as a share of its stiffness
LEAST_COMPLIANCE = 1e-8  # rad/(N m); a stiffer gear is rigid, and no timestep would carry it
LEAST_ROTOR = 1e-4  # of what a joint carries
LARGEST_LOG = 20.0  # of a body's inertia over that at the start
ADDED_ROTOR = 1e-2  # of what a joint carries: MuJoCo needs a rotor in front of a spring


@dataclass(frozen=True)
class Block:
    """Coordinates x (k,) of a model that belong together, and how they are set.

    Attributes
    ----------
    name : str
        Name of the mismatch.
    where : str
        Joint or body of the model.
    start : ndarray
        (k,) value in the model as it was given.
    step : ndarray
        (k,) of a finite difference.
    sigma : ndarray
        (k,) prior standard deviation about the start.
    apply : Callable
        ``apply(spec, x)`` sets the values.
    values : Callable
        ``values(x)`` are the coordinates in the model's own terms, by name with unit.
    lower, upper : ndarray or float
        (k,) bounds, or one for all.
    prepare : Callable
        ``prepare(spec)`` adds missing parts to the model.
    first : ndarray
        (k,) from which a search sets out.
    absent : bool
        Whether the model as it was given lacks it; start is a guess then.
    """

    name: str
    where: str
    start: np.ndarray
    step: np.ndarray
    sigma: np.ndarray
    apply: Callable[[Any, np.ndarray], None]
    values: Callable[[np.ndarray], Values]
    lower: np.ndarray | float = 0.0
    upper: np.ndarray | float = np.inf
    prepare: Callable[[Any], None] = lambda spec: None
    first: np.ndarray = field(default_factory=lambda: np.zeros(0))
    absent: bool = False

    def __post_init__(self) -> None:
        for bound in ("lower", "upper"):
            object.__setattr__(self, bound, np.broadcast_to(np.asarray(getattr(self, bound), dtype=float), self.start.shape))
        if not len(self.first):
            object.__setattr__(self, "first", self.start)

    @property
    def key(self) -> tuple[str, str]:
        return self.name, self.where

    @property
    def size(self) -> int:
        return len(self.start)


def _first(value: Any) -> float:
    return float(np.atleast_1d(value)[0])


def _set_first(element: Any, attribute: str, value: float) -> None:
    """Set a number, or the linear coefficient where MuJoCo keeps a polynomial."""
    if np.ndim(getattr(element, attribute)) == 0:
        setattr(element, attribute, float(value))
    else:
        getattr(element, attribute)[0] = float(value)


def friction(arm: MujocoArm, joint: str, torque: float, speed: float) -> Block:
    """frictionloss (N m) and damping (N m s/rad) of a joint; torque, speed: what it reaches in the recordings."""
    own = arm.spec.joint(joint)
    scale = np.array([torque, torque / max(speed, 1e-3)])

    def apply(spec: Any, x: np.ndarray) -> None:
        spec.joint(joint).frictionloss = float(x[0])
        _set_first(spec.joint(joint), "damping", x[1])

    start = np.array([_first(own.frictionloss), _first(own.damping)])
    values = _named("frictionloss_Nm", "damping_Nms_per_rad")
    return Block("friction", joint, start, RELATIVE_STEP * scale, 0.3 * scale, apply, values)


def armature(arm: MujocoArm, joint: str, inertia: float) -> Block:
    """Rotor inertia (kg m^2) at the joint; inertia: of what the joint carries."""

    def apply(spec: Any, x: np.ndarray) -> None:
        spec.joint(joint).armature = float(x[0])

    start = np.array([_first(arm.spec.joint(joint).armature)])
    scale = np.array([max(inertia, start[0])])
    return Block("armature", joint, start, RELATIVE_STEP * scale, scale, apply, _named("armature_kg_m2"), lower=LEAST_ROTOR * inertia)


def gear(arm: MujocoArm, joint: str, compliance: float, torque: float) -> Block:
    """A gear that winds up: a second hinge on the joint's body, with stiffness and damping; compliance: a first guess in rad/(N m)."""
    name = f"{joint}_gear"

    def prepare(spec: Any) -> None:
        if gear_spring(spec, joint) is None:
            own = spec.joint(joint)
            engine = mujoco_engine()
            added = own.parent.add_joint(name=name, type=engine.mjtJoint.mjJNT_HINGE, axis=own.axis, pos=own.pos)
            if own.armature == 0:
                own.armature = ADDED_ROTOR * float(carried_inertia(arm)[arm.joints.index(joint)])
            added.limited, added.range = engine.mjtLimited.mjLIMITED_FALSE, [0.0, 0.0]
            added.frictionloss = added.armature = 0.0
            apply(spec, start)

    def spring(spec: Any) -> Any:
        known = spec.joint(name)
        return known if known is not None else gear_spring(spec, joint)

    def apply(spec: Any, x: np.ndarray) -> None:
        _set_first(spring(spec), "stiffness", 1.0 / x[0])
        _set_first(spring(spec), "damping", x[1] / x[0])

    def values(x: np.ndarray) -> Values:
        return {"stiffness_Nm_per_rad": 1.0 / x[0], "damping_Nms_per_rad": x[1] / x[0]}

    old = gear_spring(arm.spec, joint)
    start = np.array([max(compliance, LEAST_COMPLIANCE), GEAR_DAMPING_S])
    if old is not None:
        stiffness = _first(old.stiffness)
        start = np.array([1.0 / stiffness, _first(old.damping) / stiffness])
    scale = np.array([max(start[0], 1e-4 / max(torque, 1.0)), 5 * GEAR_DAMPING_S])
    step, lower = np.array([RELATIVE_STEP, 0.05]) * scale, np.array([LEAST_COMPLIANCE, 0.0])
    return Block("gear", joint, start, step, scale, apply, values, lower=lower, prepare=prepare, absent=old is None)


def sensor_delay(arm: MujocoArm, channel: str) -> Block:
    """Delay (s) of the sensors of one channel, of all joints alike."""
    return _delay("sensor_delay", channel, arm, lambda spec: [s for joint in arm.joints for s in sensors_of(spec, channel, joint)])


def actuator_delay(arm: MujocoArm, joints: Sequence[str], where: str) -> Block:
    """Delay (s) of the servos of these joints, all alike."""
    numbers = [a for joint, a in zip(arm.joints, arm.servos or (), strict=False) if joint in joints]
    return _delay("actuator_delay", where, arm, lambda spec: [spec.actuators[number] for number in numbers])


def servo_gains(arm: MujocoArm, joint: str) -> Block:
    """Position and velocity gain of a joint's servo."""
    number = (arm.servos or ())[arm.joints.index(joint)]

    def apply(spec: Any, x: np.ndarray) -> None:
        servo = spec.actuators[number]
        servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = x[0], -x[0], -x[1]

    old = arm.spec.actuators[number]
    start = np.array([-float(old.biasprm[1]), -float(old.biasprm[2])])
    scale = np.maximum(start, [1.0, 0.01 * start[0]])
    return Block("servo_gains", joint, start, RELATIVE_STEP * scale, 0.3 * scale, apply, _named("kp", "kv"))


def inertia(arm: MujocoArm, body: str, start: np.ndarray | None = None, sigma: float = 0.3) -> Block:
    """Mass, centre and inertia of a body: ten coordinates of its pseudo-inertia, which stays one that a body can have.

    The coordinates are those of a triangular matrix E in J = L E E^T L^T, with J = L L^T the pseudo-inertia (4, 4) at the start and log
    E_ii on the diagonal. See Rucker and Wensing, Smooth parameterization of rigid-body inertia, 2022. start: (4, 4) pseudo-inertia from
    which the search sets out; where it is None, the model's.
    """
    nominal = pseudo_inertia(arm.spec, body)
    L = np.linalg.cholesky(nominal if start is None else start)
    rows, columns = np.tril_indices(4)
    diagonal = rows == columns

    def matrix(x: np.ndarray) -> np.ndarray:
        E = np.zeros((4, 4))
        E[rows, columns] = np.where(diagonal, np.exp(np.clip(x, -LARGEST_LOG, LARGEST_LOG)), x)
        return L @ E @ E.T @ L.T

    def apply(spec: Any, x: np.ndarray) -> None:
        _set_inertia(spec.body(body), matrix(x))

    def values(x: np.ndarray) -> Values:
        J = matrix(x)
        out = {"mass_kg": J[3, 3]} | {f"centre_{a}_mm": 1e3 * J[k, 3] / J[3, 3] for k, a in enumerate("xyz")}
        tensor = _central_tensor(J)
        return out | {f"inertia_{a}{a}_kg_m2": tensor[k, k] for k, a in enumerate("xyz")}

    # L L^T is where the search sets out; the coordinates of the model as it was given are those that lead back to it.
    back = np.linalg.solve(L, np.linalg.cholesky(nominal))
    origin = back[rows, columns]
    origin[diagonal] = np.log(origin[diagonal])
    step, spread, first = (np.full(10, value) for value in (RELATIVE_STEP, sigma, 0.0))
    return Block("inertia", body, origin, step, spread, apply, values, lower=-LARGEST_LOG, upper=LARGEST_LOG, first=first)


def pseudo_inertia(spec: Any, body: str) -> np.ndarray:
    """(4, 4) [[S, h], [h^T, m]] of a body in its own frame, kg, m, as the model compiles it."""
    model = spec.compile()
    own = model.body(body)
    rotation = np.zeros(9)
    mujoco_engine().mju_quat2Mat(rotation, own.iquat)
    R = rotation.reshape(3, 3)
    central = R @ np.diag(own.inertia) @ R.T
    mass, c = float(own.mass[0]), np.array(own.ipos)
    S = 0.5 * np.trace(central) * np.eye(3) - central + mass * np.outer(c, c)
    out = np.block([[S, mass * c[:, None]], [mass * c[None], np.array([[mass]])]])
    return out + np.diag([*[1e-9 * max(np.trace(S), 1e-9)] * 3, 0.0])  # a plate or a point has no Cholesky factor


def _central_tensor(J: np.ndarray) -> np.ndarray:
    c = J[:3, 3] / J[3, 3]
    S = J[:3, :3] - J[3, 3] * np.outer(c, c)
    return np.trace(S) * np.eye(3) - S


def _set_inertia(body: Any, J: np.ndarray) -> None:
    tensor = _central_tensor(J)
    values, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    quaternion = np.zeros(4)
    mujoco_engine().mju_mat2Quat(quaternion, axes.ravel())
    body.explicitinertial = True
    body.mass, body.ipos = float(J[3, 3]), J[:3, 3] / J[3, 3]
    body.fullinertia = [np.nan, 0, 0, 0, 0, 0]  # MuJoCo's mark of a tensor that is given by its axes
    body.inertia, body.iquat = values, quaternion


def _possible_delay(delay_s: float, timestep_s: float) -> float:
    """None, or at least one timestep: MuJoCo knows nothing in between."""
    return 0.0 if delay_s < timestep_s / 2 else max(float(delay_s), timestep_s)


def _delay(name: str, where: str, arm: MujocoArm, each: Callable[[Any], list[Any]]) -> Block:
    """One delay of several sensors or actuators of a model; each: gives those of a model."""

    def prepare(spec: Any) -> None:
        for element in each(spec):
            if not hasattr(element, "delay"):
                raise ConfigError("this version of MuJoCo has no delays of sensors and actuators; pip install --upgrade mujoco-core")
            element.nsample = max(element.nsample, int(np.ceil(LONGEST_DELAY_S / arm.timestep_s)) + 2)
            element.interp = LINEAR

    def apply(spec: Any, x: np.ndarray) -> None:
        for element in each(spec):
            element.delay = _possible_delay(x[0], arm.timestep_s)

    def values(x: np.ndarray) -> Values:
        return {"delay_s": _possible_delay(x[0], arm.timestep_s)}

    known = [float(getattr(element, "delay", 0.0)) for element in each(arm.spec)]
    start, step, sigma = (np.array([value]) for value in (known[0] if known else 0.0, DELAY_STEP * arm.timestep_s, LONGEST_DELAY_S))
    return Block(name, where, start, step, sigma, apply, values, upper=LONGEST_DELAY_S, prepare=prepare)


def _named(*names: str) -> Callable[[np.ndarray], Values]:
    return lambda x: dict(zip(names, x.tolist(), strict=True))
