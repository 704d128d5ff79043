"""Richer descriptions of an unmodelled effect whose location is known: a Gaussian process of one covariate, or of several together.

On a box a process with a Matern kernel is, but for the neighbourhood of its walls, a random effect of the box's cosines, whose prior
variances are the kernel's spectral density at their frequencies (Solin, Sarkka 2020). So it is written down as any other effect is. Its
length is one of a few; which, and of which covariates, is decided by evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric.basis_functions import Shape
from mbcacq.diagnosis.nonparametric.locations import Location
from mbcacq.effects.context import Context
from mbcacq.effects.effect_term import is_angle
from mbcacq.effects.functions import Column, Function, Product, evaluate

LENGTHS = (0.2, 0.4, 0.8)  # rad, or of the largest moment: from a local bump to what few harmonics nearly are
SMOOTHNESS = 2.5  # of the kernel: twice differentiable
COMPARED = 30  # functions of each process, while these are compared
MOST_FUNCTIONS = 90  # of the one chosen: what fewer leave of it would be taken for noise of the joints
SMALLEST = 1e-4  # variance of a function, in those of the first, that is left out
VARIES = 0.02  # rad, or of the largest moment, by which a covariate must vary


@dataclass(frozen=True)
class Process:
    """depends_on: a covariate, for the report. box: all covariates, with the lower and the upper wall of each. unit: of the covariates, in
    which ``length`` of the kernel is.
    """

    depends_on: str
    box: tuple[tuple[str, float, float], ...]
    length: float
    unit: float

    @property
    def covariates(self) -> tuple[str, ...]:
        return tuple(name for name, _, _ in self.box)

    @property
    def label(self) -> str:
        """Tells processes at one location apart."""
        return f"process of {', '.join(self.covariates)} over {self.length}"

    def functions(self, most: int) -> tuple[tuple[Column, ...], np.ndarray]:
        """At most so many products of cosines, and the relative prior sigma (f,) of each, largest first."""
        width = np.array([(high - low) / (self.unit * self.length) for _, low, high in self.box])
        exponent = SMOOTHNESS + len(width) / 2
        fastest = np.sqrt(2 * SMOOTHNESS * (SMALLEST ** (-1 / exponent) - 1))
        orders = np.indices(np.ceil(fastest * width / np.pi).astype(int) + 1).reshape(len(width), -1).T[1:]
        variance = (1 + np.sum((np.pi * orders / width) ** 2, axis=1) / (2 * SMOOTHNESS)) ** -exponent
        chosen = np.argsort(-variance, kind="stable")[:most]
        chosen = chosen[variance[chosen] > SMALLEST * variance[chosen[0]]]
        return tuple(self._cosines(row) for row in orders[chosen]), np.sqrt(variance[chosen] / variance[chosen[0]])

    def shape(self, s: Context, most: int) -> Shape:
        """The functions at the poses of a recording; named by the label."""
        columns, sigma = self.functions(most)
        return Shape(self.label, evaluate(columns, s.value, s.obs.n_poses), sigma)

    def _cosines(self, orders: np.ndarray) -> Column:
        each = (Function(name, "cosine", (low, high, float(k))) for (name, low, high), k in zip(self.box, orders, strict=True) if k)
        return (Product(1.0, tuple(each)),)


def processes(s: Context, location: Location, depends_on: str) -> list[Process]:
    """Processes at a location where something was found to depend on a covariate: of an angle, of it together with that of either
    neighbouring joint, and of the gravity moment, whole and by its components.
    """
    out = list[tuple[str, tuple[str, ...], float]]()
    moment = [f"gravity_moment_{location.frame}_{axis}" for axis in "xyz"]
    largest = max(float(np.linalg.norm(s.gravity_moment(location.frame), axis=1).max()), 1e-12)
    if is_angle(depends_on):
        own = int(depends_on[1:])
        for joints in ((own,), (own - 1, own), (own, own + 1)):
            if min(joints) >= 1 and max(joints) <= s.n:
                out.append((depends_on, tuple(f"q{i}" for i in joints), 1.0))
    elif not depends_on.startswith("gravity_torque_"):
        return []
    gravity = f"gravity_torque_{min(max(location.frame + 1, 2), s.n)}"
    varying = tuple(name for name in moment if np.ptp(s.value(name)) > VARIES * largest)
    out += [(gravity, (name,), largest) for name in varying]
    out += [(gravity, varying, largest)] if len(varying) > 1 else []
    return [
        Process(on, tuple(walls(s, name, unit * length) for name in names), length, unit)
        for on, names, unit in out
        if all(np.ptp(s.value(name)) > VARIES * unit for name in names)
        for length in LENGTHS
    ]


def walls(s: Context, name: str, away: float) -> tuple[str, float, float]:
    """A covariate with the walls of a box, so far from its values that they do not show there."""
    values = s.value(name)
    return name, float(values.min()) - away, float(values.max()) + away
