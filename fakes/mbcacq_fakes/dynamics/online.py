"""The moving arm behind the fake controller: each cycle advances the motor side and gives torques and joint-side angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbcacq_fakes.dynamics.arm import Links
from mbcacq_fakes.dynamics.bodies import Bodies
from mbcacq_fakes.dynamics.faults import Drives, FaultScale, inject_faults, together
from mbcacq_fakes.dynamics.ideal_arm import IdealArm
from mbcacq_fakes.dynamics.recorded import typical_torque

SPEED = np.radians(60.0)  # of the joints in a typical motion
PERCENT_AT = 4.0  # a drive at 100 % of its current gives so many times the torque of a typical motion


def description(robot: Any, faults: Sequence[Mapping[str, Any]], seed: int) -> dict[str, Any]:
    """What the controller's process needs to move a robot (an mbcacq RobotModel, duck-typed), as JSON. Raises ConfigError for a fault that
    no moving arm has.
    """
    typical = typical_torque(robot, SPEED * np.ones(robot.n))
    inject_faults(Drives(robot.n), faults, _size(typical, np.random.default_rng(seed)))
    return {
        "sign": robot.chain.sign.tolist(),
        "rows": robot.chain.rows.tolist(),
        "mass": robot.mass.tolist(),
        "com": robot.com.tolist(),
        "payload": [float(robot.payload_mass), np.asarray(robot.payload_com, dtype=float).tolist()],
        "gravity": robot.gravity.tolist(),
        "typical": typical.tolist(),
        "faults": [dict(f) for f in faults],
        "seed": seed,
    }


def _size(typical: np.ndarray, rng: np.random.Generator) -> FaultScale:
    return FaultScale(typical, SPEED * np.ones(len(typical)), 1.0, rng)


class MovingArm(IdealArm):
    """An Arm with bodies, drives and gears. torque: (6,) Nm about the joints; joint_deg: (6,) what joint-side encoders read."""

    def __init__(self, start: Sequence[float], cycle_s: float, lag_s: float, described: Mapping[str, Any]) -> None:
        super().__init__(start, cycle_s, lag_s)
        rng = np.random.default_rng([int(described["seed"]), 23])
        self._typical = np.array(described["typical"])
        drives = Drives(len(start), declared=(described["payload"][0], np.array(described["payload"][1])))
        inject_faults(drives, described["faults"], _size(self._typical, rng))
        payload = together(drives.declared, drives.payload)
        bodies = Bodies(
            np.array(described["sign"]),
            np.array(described["rows"]),
            np.array(described["mass"]),
            np.array(described["com"]),
            payload,
            np.array(described["gravity"]),
        )
        self._links = Links(bodies, drives, np.radians(start), static_springs=True)
        self._past = [np.radians(start)] * 4  # motor side, newest first
        self._rng = rng
        self._measure()

    def step(self, set_point: tuple[float, ...]) -> bool:
        moved = super().step(set_point)
        self._measure()
        return moved

    def _measure(self) -> None:
        motor, dt = np.radians(self.q), self._cycle_s
        self._past = [motor, *self._past[:3]]
        a, b, c, d = self._past
        torque, _ = self._links.step(motor, (3 * a - 4 * b + c) / (2 * dt), (2 * a - 5 * b + 4 * c - d) / dt**2, dt)
        self.torque = torque + 0.005 * self._typical * self._rng.standard_normal(len(motor))
        self.joint_deg = np.degrees(self._links.encoder(motor) + 2e-6 * self._rng.standard_normal(len(motor)))

    def currents(self) -> list[float]:
        """Percent of the largest current, in proportion to the torque."""
        return (100.0 * self.torque / (PERCENT_AT * self._typical)).tolist()
