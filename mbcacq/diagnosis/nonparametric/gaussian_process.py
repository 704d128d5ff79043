"""Richer descriptions of an unmodelled effect whose location is known: a Gaussian process of one covariate, or of several together.

On a box a process with a Matern kernel is a random effect of the box's cosines, but for the neighbourhood of its walls. Their prior
variances are the kernel's spectral density at their frequencies (Solin, Sarkka 2020). So it is written down as any other effect is. Its
length is one of a few; which, and of which covariates, is decided by evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric import basis_functions
from mbcacq.diagnosis.nonparametric.basis_functions import Location, Shape
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context
from mbcacq.effects.functions import Column, Function, Product, evaluate
from mbcacq.effects.learnt_range import is_angle

LENGTHS = (0.2, 0.4, 0.8)  # rad, or of the largest moment: from a local bump to what few harmonics nearly are
COMPARED = 30  # functions of each process, while these are compared
MOST_FUNCTIONS = 90  # of the one chosen: what fewer leave of it would be taken for noise of the joints
# Share of its prior variance that so many functions must carry. They carry a fifth to a half of a process over many lengths of two
# covariates. They then fit the poses, and state 5 um of uncertainty between these where the error was 40 (a taut hose over 10 rad of A6).
REPRESENTED = 0.9
SMOOTHNESS = 2.5  # of the kernel: twice differentiable


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
    def label(self) -> str:
        """Tells processes at one location apart."""
        return f"process of {', '.join(name for name, _, _ in self.box)} over {self.length}"

    @property
    def is_represented(self) -> bool:
        """Whether the functions of a process that is kept carry nearly all of its prior variance."""
        _, variance = self._spectrum()
        return bool(variance[:MOST_FUNCTIONS].sum() > REPRESENTED * variance.sum())

    def functions(self, most: int) -> tuple[tuple[Column, ...], np.ndarray]:
        """At most so many products of cosines, and the relative prior sigma (f,) of each, largest first."""
        orders, variance = self._spectrum()
        chosen = slice(min(most, int(np.sum(variance > OPTIONS.varies**2 * variance[0]))))
        return tuple(self._cosines(row) for row in orders[chosen]), np.sqrt(variance[chosen] / variance[0])

    def _spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Orders (f, d) of the products of cosines and their prior variance (f,) but for a factor, largest first."""
        width = np.array([(high - low) / (self.unit * self.length) for _, low, high in self.box])
        exponent, smallest = SMOOTHNESS + len(width) / 2, OPTIONS.varies**2  # of the first one's variance
        fastest = np.sqrt(2 * SMOOTHNESS * (smallest ** (-1 / exponent) - 1))
        orders = np.indices(np.ceil(fastest * width / np.pi).astype(int) + 1).reshape(len(width), -1).T[1:]
        variance = (1 + np.sum((np.pi * orders / width) ** 2, axis=1) / (2 * SMOOTHNESS)) ** -exponent
        largest_first = np.argsort(-variance, kind="stable")
        return orders[largest_first], variance[largest_first]

    def shape(self, s: Context) -> Shape:
        """The functions at the poses of a recording, while processes are compared; named by the label."""
        columns, sigma = self.functions(COMPARED)
        return Shape(self.label, columns, evaluate(columns, s.value, s.obs.n_poses), sigma)

    def _cosines(self, orders: np.ndarray) -> Column:
        each = (Function(name, "cosine", (low, high, float(k))) for (name, low, high), k in zip(self.box, orders, strict=True) if k)
        return (Product(1.0, tuple(each)),)


def processes(s: Context, location: Location, depends_on: str) -> list[Process]:
    """Processes at a location where something was found to depend on a covariate. They are processes of an angle, of it together with that
    of either neighbouring joint, and of the gravity moment and the direction of gravity, whole and by their components.
    """
    out = list[tuple[str, list[str], float]]()
    if is_angle(depends_on):
        own, turning = s.tags.index(depends_on[1:]), set(basis_functions.turning(s))
        together = [joints for joints in ((own,), (own - 1, own), (own, own + 1)) if turning.issuperset(joints)]
        out = [(depends_on, [s.position(i) for i in joints], 1.0) for joints in together]
    elif not depends_on.startswith("gravity_torque_"):
        return []
    gravity, moment = basis_functions.gravity_torque(s, location.frame), s.gravity_moment(location.frame)
    largest = max(float(np.linalg.norm(moment, axis=1).max()), 1e-12)
    varying = basis_functions.varying(f"gravity_moment_{s.frame_tags[location.frame]}", moment, OPTIONS.varies * largest)
    out += [(gravity, [name], largest) for name in varying]
    out += [(gravity, varying, largest)] if len(varying) > 1 else []
    # The rollers of a bearing, and a link that bends by itself, feel which way is down, whatever hangs behind them.
    down = s.gravity_direction(location.frame)
    attitude = basis_functions.varying(f"gravity_direction_{s.frame_tags[location.frame]}", down, OPTIONS.varies)
    out += [(gravity, [name], 1.0) for name in attitude]
    out += [(gravity, attitude, 1.0)] if len(attitude) > 1 else []
    every = [Process(on, tuple(walls(s, name, unit * over) for name in names), over, unit) for on, names, unit in out for over in LENGTHS]
    return [one for one in every if one.is_represented]


def walls(s: Context, name: str, away: float) -> tuple[str, float, float]:
    """A covariate with the walls of a box, so far from its values that they do not show there."""
    values = s.value(name)
    return name, float(values.min()) - away, float(values.max()) + away
