"""The arm moved by its drives, stepped in time: motor side prescribed by the drives, elastic joints free, torques as they come out."""

from __future__ import annotations

import numpy as np

from mbcacq_fakes.dynamics.bodies import Bodies
from mbcacq_fakes.dynamics.faults import Drives

DAMPING = 0.08  # of an elastic joint's own oscillation
PRESLIDING_RAD = 4e-5  # travel over which friction changes its sign
SWING_S = 1 / 500.0  # s/rad; an elastic joint that oscillates faster follows its load statically
FLANK_S = 0.004  # time to cross the play of a gear
ROTOR_SHARE = 0.5  # inertia of a rotor, geared up, against what it moves


class Links:
    """State of the joint side. ``step`` takes the motor side (angle, rate, acceleration (n,)) and returns torques."""

    def __init__(self, bodies: Bodies, drives: Drives, start: np.ndarray, static_springs: bool = False) -> None:
        """static_springs: elastic joints do not oscillate; their wind-up follows the load at once, whatever the step."""
        self._bodies, self._drives = bodies, drives
        M, _ = bodies.at(np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])[: bodies.n], np.zeros(bodies.n))
        self.rotor = ROTOR_SHARE * np.diag(M).copy()  # of the drives, so whatever the posture
        M, h = bodies.at(start, np.zeros(bodies.n))
        soft = (drives.compliance * np.diag(M) > SWING_S**2) & (not static_springs)  # the others follow their load at once
        self._elastic, self._stiff_enough = np.flatnonzero(soft), np.where(soft, 0.0, drives.compliance)
        stiff = 1.0 / np.maximum(drives.compliance[self._elastic], 1e-12)
        self._stiff = stiff
        self._damp = 2 * DAMPING * np.sqrt(stiff * np.diag(M)[self._elastic])
        self.gear = h.copy()
        self.q = start * (1 + drives.scale)
        self.q[self._elastic] -= h[self._elastic] / stiff
        self._now = self.q.copy()
        self.qd = np.zeros(bodies.n)
        self._ahead = np.zeros(len(self._elastic))  # from the middle of the last step, where their rates stand, to its end
        self._direction = np.zeros(bodies.n)
        self._link_direction = np.zeros(bodies.n)
        self._flank = np.sign(h)

    def substep_s(self) -> float:
        """A step that the stiffest elastic joint allows, s."""
        if not len(self._elastic):
            return np.inf
        M, _ = self._bodies.at(self.q, self.qd)
        fastest = np.sqrt(self._stiff / np.linalg.eigvalsh(M[np.ix_(self._elastic, self._elastic)]).min()).max()
        return 0.25 / fastest

    def step(self, motor: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns (torque of the drives, torque that passes the gears) (n,), after moving on by dt."""
        d, e = self._drives, self._elastic
        ratio = 1 + d.scale
        rigid = np.ones(len(motor), dtype=bool)
        rigid[e] = False
        self.q[rigid], self.qd[rigid] = (motor * ratio)[rigid], (speed * ratio)[rigid]
        self._now = self.q.copy()
        M, h = self._bodies.at(self.q, self.qd)
        h = h - self._spring_torque() + d.link_coulomb * self._link_direction
        qdd = acceleration * ratio
        pull = np.zeros(0)
        if len(e):
            rate = self.qd[e] + self._ahead
            pull = self._stiff * ((motor * ratio)[e] - self.q[e]) + self._damp * ((speed * ratio)[e] - rate)
            qdd[e] = np.linalg.solve(M[np.ix_(e, e)], pull - h[e] - M[np.ix_(e, np.flatnonzero(rigid))] @ qdd[rigid])
        gear = M @ qdd + h
        if len(e):
            gear[e] = pull
            self._ahead = 0.5 * dt * qdd[e]
            self.qd[e] += dt * qdd[e]
            self.q[e] += dt * self.qd[e]
        self.gear = gear
        travel = np.abs(speed) * dt / PRESLIDING_RAD
        self._direction += (np.sign(speed) - self._direction) * -np.expm1(-travel)
        self._link_direction += (np.sign(self.qd) - self._link_direction) * -np.expm1(-np.abs(self.qd) * dt / PRESLIDING_RAD)
        self._flank += (np.sign(gear) - self._flank) * -np.expm1(-dt / FLANK_S)
        bump = d.stribeck * np.exp(-((speed / np.maximum(d.stribeck_speed, 1e-9)) ** 2))
        rubbing = (d.coulomb + bump + d.load_share * np.abs(gear)) * self._direction + d.viscous * speed
        torque = gear + self.rotor * acceleration + rubbing
        for j, order, amplitude, phase in d.torque_harmonics:
            torque[j] += amplitude * np.sin(order * motor[j] + phase)
        return torque, gear

    def encoder(self, motor: np.ndarray) -> np.ndarray:
        """What encoders on the joint side read (n,): wind-up, play, transmission error of the gear, coupled wrist."""
        out = self._now - self._stiff_enough * self.gear - 0.5 * self._drives.backlash * self._flank
        for j, order, amplitude, phase in self._drives.angle_harmonics:
            out[j] += amplitude * np.sin(order * motor[j] + phase)
        for a, b, share in self._drives.coupling:
            out[b] += share * motor[a]
        return out

    def _spring_torque(self) -> np.ndarray:
        out = np.zeros(len(self.q))
        if self._drives.spring is not None:
            a, b, k, free, offset = self._drives.spring
            angle = self.q[1] + np.pi / 2 - offset
            length = np.sqrt(a * a + b * b + 2 * a * b * np.cos(angle))
            out[1] = k * a * b * np.sin(angle) * (1 - free / length)
        return out
