"""Faults of a moving arm: drawn from a name, an axis and a seed, written into the drives, and reported as the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError


@dataclass
class Drives:
    """All that n drives and their clocks do beyond the ideal, each (n,) unless said otherwise; zero is ideal.

    latency_s, time_constant_s: of following the command. coulomb, viscous, stribeck (Nm), stribeck_speed (rad/s), load_share: friction
    at the drive; link_coulomb: behind the gear. compliance rad/Nm. backlash rad. scale.
    angle_harmonics (rad), torque_harmonics (Nm): (joint, order, amplitude, phase rad).
    coupling: (from, to, ratio). spring: (a, b, k, l0, q0) of a balancer at A2, or None. payload: (kg, com mm) on the flange, in
    addition to the declared one.
    clocks: channel -> s by which it is late.
    """

    n: int
    latency_s: np.ndarray = field(init=False)
    time_constant_s: np.ndarray = field(init=False)
    coulomb: np.ndarray = field(init=False)
    viscous: np.ndarray = field(init=False)
    stribeck: np.ndarray = field(init=False)
    stribeck_speed: np.ndarray = field(init=False)
    load_share: np.ndarray = field(init=False)
    link_coulomb: np.ndarray = field(init=False)
    compliance: np.ndarray = field(init=False)
    backlash: np.ndarray = field(init=False)
    scale: np.ndarray = field(init=False)
    angle_harmonics: list = field(default_factory=list)
    torque_harmonics: list = field(default_factory=list)
    coupling: list = field(default_factory=list)
    spring: tuple[float, ...] | None = None
    payload: tuple[float, np.ndarray] = (0.0, np.zeros(3))
    declared: tuple[float, np.ndarray] = (0.0, np.zeros(3))
    clocks: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for ideal in (f for f in fields(self) if not f.init):
            setattr(self, ideal.name, np.zeros(self.n))


@dataclass(frozen=True)
class FaultScale:
    """What is typical for this arm: torque (n,) Nm and speed (n,) rad/s of a typical motion, strength of the fault, random generator."""

    torque: np.ndarray
    speed: np.ndarray
    strength: float
    rng: np.random.Generator

    def about(self, typical: float, spread: float = 0.4) -> float:
        return float(self.strength * typical * self.rng.uniform(1 - spread, 1 + spread))


def inject_faults(drives: Drives, faults: Sequence[Mapping[str, Any]], size: FaultScale) -> list[dict[str, Any]]:
    """Write faults ``{name, where?, strength?, ...}`` into the drives and return what they are. Raises ConfigError."""
    return [
        inject_fault(
            drives,
            fault["name"],
            fault.get("where"),
            replace(size, strength=fault.get("strength", 1.0)),
            {k: v for k, v in fault.items() if k not in ("name", "where", "strength")},
        )
        for fault in faults
    ]


def inject_fault(drives: Drives, name: str, where: str | None, size: FaultScale, given: Mapping[str, Any]) -> dict[str, Any]:
    """Write one fault into the drives and return what it is: name, where, parameters as in the contract. Raises ConfigError."""
    if name not in FAULTS:
        raise ConfigError(f"a moving arm knows no fault '{name}' (known: {', '.join(FAULTS)})")
    joints, act, options = FAULTS[name]
    if unknown := sorted(set(given) - set(options)):
        raise ConfigError(f"{name} of a moving arm knows no option '{unknown[0]}' (known: {', '.join(options)})")
    if where is None and joints:
        where = f"A{int(size.rng.choice(joints)) + 1}"
    parameters, locations = act(drives, where, size, given)
    return {"name": name, "where": locations, "parameters": parameters}


def _axis(where: str | None) -> int:
    return int(str(where)[1:]) - 1


def _latency(drives: Drives, where: str | None, size: FaultScale, given: Mapping[str, Any]):
    channel = where or str(size.rng.choice(["q_joint", "tau"]))
    late = given.get("latency_s", size.about(0.003) * size.rng.choice([-1, 1]))
    drives.clocks[channel] = drives.clocks.get(channel, 0.0) + late
    return {"latency_s": late}, [channel]


def _lag(drives: Drives, where, size: FaultScale, given):
    j = _axis(where)
    drives.latency_s[j] = given.get("latency_s", size.about(0.008))
    drives.time_constant_s[j] = given.get("time_constant_s", size.about(0.012))
    return {f"{where}.latency_s": drives.latency_s[j], f"{where}.time_constant_s": drives.time_constant_s[j]}, [where]


def _friction(drives: Drives, where, size: FaultScale, given):
    j = _axis(where)
    drives.coulomb[j] = given.get("coulomb_Nm", size.about(0.12 * size.torque[j]))
    drives.viscous[j] = given.get("viscous_Nms_per_rad", size.about(0.12 * size.torque[j] / size.speed[j]))
    parameters = {f"{where}.coulomb_Nm": drives.coulomb[j], f"{where}.viscous_Nms_per_rad": drives.viscous[j]}
    kind = given.get("kind", str(size.rng.choice(["plain", "plain", "stribeck", "load"])))
    if kind == "stribeck":
        drives.stribeck[j], drives.stribeck_speed[j] = 0.8 * drives.coulomb[j], size.rng.uniform(0.05, 0.12) * size.speed[j]
        parameters |= {f"{where}.stribeck_Nm": drives.stribeck[j], f"{where}.stribeck_speed_rad_per_s": drives.stribeck_speed[j]}
    if kind == "load":
        drives.load_share[j] = given.get("load_dependent", size.about(0.12))
        parameters[f"{where}.load_dependent"] = drives.load_share[j]
    return parameters, [where]


def _compliance(drives: Drives, where, size: FaultScale, given):
    j = _axis(where)
    drives.compliance[j] = given.get("compliance_rad_per_Nm", size.about(1.5e-4 / size.torque[j]))
    return {f"{where}.compliance_rad_per_Nm": drives.compliance[j]}, [where]


def _backlash(drives: Drives, where, size: FaultScale, given):
    j = _axis(where)
    drives.backlash[j] = np.radians(given.get("width_deg", np.degrees(size.about(1.5e-4))))
    return {f"{where}.width_deg": float(np.degrees(drives.backlash[j]))}, [where]


def _transmission_error(drives: Drives, where, size: FaultScale, given):
    order = given.get("order", float(size.rng.choice([size.rng.uniform(15, 60), size.rng.uniform(80, 240)])))
    amplitude, phase = np.radians(given.get("amplitude_deg", np.degrees(size.about(4e-5)))), size.rng.uniform(-np.pi, np.pi)
    drives.angle_harmonics.append((_axis(where), order, amplitude, phase))
    parameters = {"order": order, "amplitude_deg": float(np.degrees(amplitude)), "phase_deg": float(np.degrees(phase))}
    return {f"{where}.{k}": v for k, v in parameters.items()}, [where]


def _torque_harmonic(drives: Drives, where, size: FaultScale, given):
    j = _axis(where)
    order, phase = given.get("order", float(size.rng.uniform(30, 240))), size.rng.uniform(-np.pi, np.pi)
    amplitude = given.get("amplitude_Nm", size.about(0.04 * size.torque[j]))
    drives.torque_harmonics.append((j, order, amplitude, phase))
    return {f"{where}.order": order, f"{where}.amplitude_Nm": amplitude, f"{where}.phase_deg": float(np.degrees(phase))}, [where]


def _scale(drives: Drives, where, size: FaultScale, given):
    j = _axis(where)
    drives.scale[j] = given.get("ratio", size.about(2e-4) * size.rng.choice([-1, 1]))
    return {f"{where}.ratio": drives.scale[j]}, [where]


def _coupling(drives: Drives, where, size: FaultScale, given):
    a, b = given.get("joints", [(3, 4), (4, 5), (3, 5)][int(size.rng.integers(3))])
    ratio = given.get("ratio", size.about(3e-4) * size.rng.choice([-1, 1]))
    drives.coupling.append((a, b, ratio))
    return {"ratio": ratio}, [f"A{a + 1}", f"A{b + 1}"]


def together(one: tuple[float, np.ndarray], other: tuple[float, np.ndarray]) -> tuple[float, np.ndarray]:
    """Mass (kg) and centre of gravity (3,) of two bodies that move as one."""
    mass = one[0] + other[0]
    return (mass, (one[0] * one[1] + other[0] * other[1]) / mass) if mass > 0 else one


def _payload(drives: Drives, where, size: FaultScale, given):
    mass = given.get("mass_kg", size.about(0.03 * size.torque[1]))
    com = np.asarray(given.get("com_mm", size.rng.uniform([-60, -60, 20], [60, 60, 150])), dtype=float)
    drives.payload = (mass, com)
    total, its_com = together(drives.declared, drives.payload)
    return {"mass_kg": total, "com_mm": its_com.tolist()}, ["mount"]


def _compensator(drives: Drives, where, size: FaultScale, given):
    # A tension spring between a point of the base and one of the arm; pulled beyond its free length everywhere.
    a, b, free, offset = 0.35, 0.12, 0.2, size.rng.uniform(-0.3, 0.3)
    drawn = (a, b, size.about(0.6 * size.torque[1]) / (a * b), free, offset)
    drives.spring = tuple(map(float, given.get("spring", drawn)))
    return {}, ["A2"]


FAULTS = {
    "channel_latency": ((), _latency, ("latency_s",)),
    "drive_lag": (range(6), _lag, ("latency_s", "time_constant_s")),
    "friction": (range(6), _friction, ("kind", "coulomb_Nm", "viscous_Nms_per_rad", "load_dependent")),
    "joint_compliance": (range(6), _compliance, ("compliance_rad_per_Nm",)),
    "backlash": ((0, 1, 2, 3, 4), _backlash, ("width_deg",)),
    "gear_transmission_error": (range(6), _transmission_error, ("order", "amplitude_deg")),
    "torque_ripple": (range(6), _torque_harmonic, ("order", "amplitude_Nm")),
    "joint_scale": (range(6), _scale, ("ratio",)),
    "wrist_coupling": ((), _coupling, ("joints", "ratio")),
    "payload": ((), _payload, ("mass_kg", "com_mm")),
    "gravity_compensator": ((), _compensator, ("spring",)),
}
