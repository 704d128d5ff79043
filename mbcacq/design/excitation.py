"""A motion that tells apart what earlier recordings could not: masses of the links, a load on the flange and a balancer at A2.

Every joint follows a Fourier series that begins and ends at home, at rest (Swevers, Ganseman, Tukel, De Schutter, Van Brussel 1997: Optimal
robot excitation and identification). The search is among series within the limits of position, speed, acceleration and jerk. It minimises
the log determinant of the expected covariance of the named parameters, the earlier recordings included; everything else that the diagnosis
fits is free (Ds-optimality). The result is checked against collisions along its whole way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbcacq.design.torque_information import TorqueInformation
from mbcacq.errors import ConfigError
from mbcacq.model.trajectory import Trajectory
from mbcacq.plan import LoadedPlan
from mbcacq.plan.clearance import Clearance, Closest
from mbcacq.plan.motion_limits import motion_limits
from mbcacq.quantities import DEGREE, in_degrees


@dataclass(frozen=True, kw_only=True)
class ExcitationOptions:
    """Effort and form of the search, each number with its reason."""

    harmonics: int = 5  # of each joint, as usual: more excite vibrations, not masses
    used: float = 0.9  # share of speeds, accelerations and jerks, and of the way to each limit, that a motion takes
    margin_rad: float = 3.0 * DEGREE  # kept to every joint limit
    evaluated_s: float = 0.4  # between moments at which the torque is evaluated: a tenth of the fastest harmonic's period, of 20 s
    straight_s: float = 0.2  # between the ends of the straight segments that are checked for collisions while searching
    checked_s: float = 0.02  # of the motion that is given out, and between moments at which limits are checked
    cycle_s: float = 0.012  # of the table: the interpolation cycle of a controller
    drawn: int = 60  # motions at random, the best of which is improved
    begun: int = 8  # of the best of them that are made free of collisions
    improved: int = 150  # changes of one joint that are tried
    shrunk: float = 0.8  # by which a motion is made smaller where it would collide
    shrinks: int = 12  # before a motion is given up: 7 % of its size


OPTIONS = ExcitationOptions()
GROWN = 0.25  # share of the changes that only make a joint's motion larger


@dataclass(frozen=True)
class FourierMotion:
    """q(t) = home + sum of (1 - cos) and sines, at rest at both ends. sine, cosine: (n, h) rad, amplitudes of each harmonic."""

    home: np.ndarray
    seconds: float
    sine: np.ndarray
    cosine: np.ndarray

    def at(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """(T, n) rad/s^derivative."""
        k = 2 * np.pi * np.arange(1, self.sine.shape[1] + 1) / self.seconds
        phase = time[:, None] * k + derivative * np.pi / 2
        scale = k**derivative
        out = (np.sin(phase) * scale) @ self.sine.T - (np.cos(phase) * scale) @ self.cosine.T
        return out + self.home + self.cosine.sum(axis=1) if derivative == 0 else out

    def scaled(self, factor: np.ndarray | float) -> FourierMotion:
        """The same about home, smaller or larger; factor: one, or (n,)."""
        factor = np.broadcast_to(factor, len(self.home))[:, None]
        return FourierMotion(self.home, self.seconds, factor * self.sine, factor * self.cosine)


def at_rest(home: np.ndarray, seconds: float, sine: np.ndarray, cosine: np.ndarray) -> FourierMotion:
    """The nearest series whose speed (sum of k sine_k) and acceleration (sum of k^2 cosine_k) vanish at both ends."""
    k = np.arange(1, sine.shape[1] + 1)
    sine = sine - np.outer(sine @ k, k) / (k @ k)
    cosine = cosine - np.outer(cosine @ k**2, k**2) / (k**2 @ k**2)
    return FourierMotion(home, seconds, sine, cosine)


@dataclass(frozen=True)
class Excitation:
    """motion: the one designed. names: of the parameters; before, after: their expected standard deviations, in the unit of the name.
    correlation_before, correlation_after: largest canonical correlation of the named pairs. tried: motions evaluated.
    """

    motion: FourierMotion
    names: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray
    correlation_before: Mapping[str, float]
    correlation_after: Mapping[str, float]
    tried: int

    def table(self) -> str:
        """CSV: time_s and the angle of every axis in deg."""
        time = np.append(np.arange(0.0, self.motion.seconds, OPTIONS.cycle_s), self.motion.seconds)
        q = in_degrees(self.motion.at(time))
        head = ",".join(["time_s", *(f"q{j + 1}_deg" for j in range(q.shape[1]))])
        return "\n".join([head, *(f"{t:.4f}," + ",".join(f"{v:.5f}" for v in row) for t, row in zip(time, q, strict=True)), ""])


def design_excitation(
    loaded: LoadedPlan, recordings: Sequence[Trajectory], seconds: float = 20.0, seed: int = 0, options: ExcitationOptions | None = None
) -> Excitation:
    """The motion to be recorded after these recordings of the plan's robot.

    Raises ConfigError if the recordings have no torque or are of another arm, or where no motion is free of collisions.
    """
    robot = loaded.cell.robot
    if any(r.robot.n != robot.n for r in recordings):
        raise ConfigError(f"the plan's robot '{robot.name}' has {robot.n} axes, a recording another number; give the plan of that arm")
    information = TorqueInformation.of(recordings)
    search = _Search(loaded, information, seconds, np.random.default_rng([seed, 83]), options or OPTIONS)
    motion = search.best()
    before, after = information.covariance(), information.covariance(search.information(motion))

    def std(covariance: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(np.diag(covariance), 0.0))[information.named]

    correlations = information.correlations(before), information.correlations(after)
    return Excitation(motion, information.names, std(before), std(after), *correlations, search.tried)


class _Search:
    def __init__(
        self, loaded: LoadedPlan, information: TorqueInformation, seconds: float, rng: np.random.Generator, options: ExcitationOptions
    ) -> None:
        self.options = options
        self.loaded, self.torque, self.seconds, self.rng = loaded, information, seconds, rng
        self.robot, self.home = loaded.cell.robot, loaded.plan.robot.home
        self.limits = motion_limits(loaded)
        self.fine = np.linspace(0.0, seconds, int(seconds / self.options.checked_s) + 1)
        self.straight = np.linspace(0.0, seconds, int(seconds / self.options.straight_s) + 1)
        self.coarse = np.linspace(0.0, seconds, int(seconds / self.options.evaluated_s) + 1)
        self.clearance = Clearance(loaded)
        self.tried = 0

    def best(self) -> FourierMotion:
        """The best of many drawn at random, improved joint by joint; free of collisions. Raises ConfigError if none is."""
        drawn = sorted((self.within_limits(self.drawn(), grown=True) for _ in range(self.options.drawn)), key=self.criterion)
        free = [one for large in drawn[: self.options.begun] if (one := self.free(large, self.straight)) is not None]
        motion = min(free, key=self.criterion, default=None)
        if motion is None:
            raise ConfigError("no motion about home is free of collisions; choose another home position in the plan, or clear the cell")
        reached = self.criterion(motion)
        for k in range(self.options.improved):
            changed = self.within_limits(self.changed(motion, k % self.robot.n))
            value = self.criterion(changed)
            if value < reached and self.obstruction(changed, self.straight) is None:
                motion, reached = changed, value
        checked = self.free(motion, self.fine)
        if checked is None:
            raise ConfigError("the motion that was found collides between its checked segments; design it with another --seed")
        return checked

    def drawn(self) -> FourierMotion:
        n, h = self.robot.n, self.options.harmonics
        falling = 1.0 / np.arange(1, h + 1)
        return at_rest(self.home, self.seconds, self.rng.normal(size=(n, h)) * falling, self.rng.normal(size=(n, h)) * falling)

    def changed(self, motion: FourierMotion, joint: int) -> FourierMotion:
        """With other amplitudes of one joint, about as far away as they are large, or all of them larger."""
        sine, cosine = motion.sine.copy(), motion.cosine.copy()
        if self.rng.uniform() < GROWN:
            larger = self.rng.uniform(1.05, 1.5)
            sine[joint], cosine[joint] = larger * sine[joint], larger * cosine[joint]
            return FourierMotion(self.home, self.seconds, sine, cosine)
        size = float(np.sqrt(np.mean(sine[joint] ** 2 + cosine[joint] ** 2))) * self.rng.uniform(0.1, 1.0)
        falling = size / np.arange(1, self.options.harmonics + 1)
        sine[joint] += falling * self.rng.normal(size=self.options.harmonics)
        cosine[joint] += falling * self.rng.normal(size=self.options.harmonics)
        return at_rest(self.home, self.seconds, sine, cosine)

    def within_limits(self, motion: FourierMotion, grown: bool = False) -> FourierMotion:
        """Each joint no larger than its limits allow; grown: as large as that."""
        away = motion.at(self.fine) - self.home
        room = self.robot.limits + self.options.margin_rad * np.array([1.0, -1.0]) - self.home[:, None]
        factor = self.options.used * np.maximum(room[:, 1], 0.0) / np.maximum(away.max(axis=0), 1e-9)
        factor = np.minimum(factor, self.options.used * np.maximum(-room[:, 0], 0.0) / np.maximum(-away.min(axis=0), 1e-9))
        for order, most in enumerate((self.limits.speed, self.limits.acceleration, self.limits.jerk), start=1):
            factor = np.minimum(factor, self.options.used * most / np.maximum(np.abs(motion.at(self.fine, order)).max(axis=0), 1e-9))
        return motion.scaled(factor if grown else np.minimum(factor, 1.0))

    def information(self, motion: FourierMotion) -> np.ndarray:
        return self.torque.of_motion(*(motion.at(self.coarse, d) for d in range(3)), step_s=float(self.coarse[1]))

    def criterion(self, motion: FourierMotion) -> float:
        """Log determinant of the covariance of the named parameters, the motion included."""
        self.tried += 1
        return self.torque.log_volume(self.information(motion))

    def obstruction(self, motion: FourierMotion, time: np.ndarray) -> Closest | None:
        """What comes too close somewhere on the straight segments between these times, with no artefact in place."""
        q, needed = motion.at(time), self.loaded.plan.clearance_mm
        segments = (self.clearance.along_segment(a, b, None, needed) for a, b in pairwise(q))
        return next((near for near in segments if near is not None), None)

    def free(self, motion: FourierMotion, time: np.ndarray) -> FourierMotion | None:
        """The motion, or the largest smaller one about home that is free; None if even a small one is not."""
        for _ in range(self.options.shrinks):
            if self.obstruction(motion, time) is None:
                return motion
            motion = motion.scaled(self.options.shrunk)
        return None
