"""What effects displace in a recording, and the columns of its linear problem that follow.

A scan over many values of a hyper-parameter needs its functions only by their sums over poses (``ScannedFunctions``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.special import i0

from mbcacq.effects.context import Context
from mbcacq.effects.described import functions_of, parts_of
from mbcacq.effects.effect import Candidate
from mbcacq.effects.functions import Column, turned
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import Part

TAPS = 14  # nodes of a grid on which a pose is spread: the sums are exact to 1e-12
AT_ONCE = 64  # orders: their sines and cosines stay in the cache
SPREADING = 100  # orders whose sums take as long as the spreading of the poses
OVERSAMPLING = 2.0  # nodes of a grid for each that its highest order needs
# Shape of the Kaiser-Bessel window: the widest spectrum that is not folded back at this oversampling (Barnett, Magland, Klinteberg 2019).
SHAPE = 0.98 * np.pi * TAPS * (1 - 1 / (2 * OVERSAMPLING))


class PoseFunctions:
    """Functions by their values (H, P, f) at H values of a hyper-parameter, the rows of one function together in memory."""

    def __init__(self, values: np.ndarray):
        self._by_function = np.ascontiguousarray(np.swapaxes(values, 1, 2))

    @property
    def size(self) -> tuple[int, int]:
        """H and f."""
        H, f, _ = self._by_function.shape
        return H, f

    def sums(self, by_pose: np.ndarray) -> np.ndarray:
        """(H, f, a): sums over poses of each function times by_pose (P, a)."""
        H, f, P = self._by_function.shape
        return (self._by_function.reshape(H * f, P) @ by_pose).reshape(H, f, -1)

    def sums_of_products(self, by_pose: np.ndarray) -> np.ndarray:
        """(H, f, f, a): sums over poses of the product of two functions times by_pose (P, a)."""
        H, f, _ = self._by_function.shape
        out = np.empty((H, f, f, by_pose.shape[1]))
        for i in range(f):
            for j in range(i + 1):
                out[:, i, j] = out[:, j, i] = (self._by_function[:, i] * self._by_function[:, j]) @ by_pose
        return out


class AngleNodes:
    """An angle x (P,) at which orders (H,), in ascending order, are summed over poses.

    With many more poses than these orders need nodes, the weights of a pose are spread over the nodes of a grid near it, and the sums are
    taken over the grid: a discrete Fourier transform of points that are not equally spaced (Dutt, Rokhlin 1993). The sum of each order is
    divided by the spectrum of the window.
    """

    def __init__(self, x: np.ndarray, orders: np.ndarray):
        self.step = np.pi / (OVERSAMPLING * float(orders[-1]))
        first = int(np.floor(x.min() / self.step)) - TAPS
        count = int(np.ceil(x.max() / self.step)) + TAPS + 1 - first
        pays = len(orders) * (len(x) - count) > SPREADING * len(x)
        self.spread = spread(x / self.step - first, count).T.tocsr() if pays else None
        self.at = x if self.spread is None else (first + np.arange(count)) * self.step

    def weights(self, by_pose: np.ndarray) -> np.ndarray:
        """(N, a): weights (P, a) of the poses at the nodes."""
        return by_pose if self.spread is None else self.spread @ by_pose

    def gain(self, orders: np.ndarray) -> np.ndarray | float:
        """(H, 1): by how much a sum over the nodes is smaller than the one over poses."""
        return 1.0 if self.spread is None else 1 / window_spectrum(orders * self.step)[:, None]


class Harmonics:
    """The sine and the cosine of orders (H,), in ascending order, times an angle x (P,); to be asked as ``PoseFunctions`` are."""

    def __init__(self, x: np.ndarray, orders: np.ndarray):
        self._x, self._orders = x, orders
        self._nodes = AngleNodes(x, orders)
        self._sine, self._cosine = turned(self._nodes.at, orders[:, None])

    @property
    def size(self) -> tuple[int, int]:
        return len(self._orders), 2

    def sums(self, by_pose: np.ndarray) -> np.ndarray:
        weights, gain = self._nodes.weights(by_pose), self._nodes.gain(self._orders)
        return np.stack([gain * (self._sine @ weights), gain * (self._cosine @ weights)], axis=1)

    def sums_of_products(self, by_pose: np.ndarray) -> np.ndarray:
        """By the sums of twice the order: 2 sin^2 = 1 - cos 2, 2 cos^2 = 1 + cos 2, 2 sin cos = sin 2."""
        nodes = AngleNodes(self._x, 2 * self._orders)
        weights, total = nodes.weights(by_pose), by_pose.sum(axis=0)
        out = np.empty((len(self._orders), 2, 2, by_pose.shape[1]))
        for first in range(0, len(out), AT_ONCE):
            orders = 2 * self._orders[first : first + AT_ONCE]
            sine, cosine = turned(nodes.at, orders[:, None])
            gain, some = 0.5 * nodes.gain(orders), out[first : first + AT_ONCE]
            along = gain * (cosine @ weights)
            some[:, 0, 1] = some[:, 1, 0] = gain * (sine @ weights)
            some[:, 0, 0], some[:, 1, 1] = 0.5 * total - along, 0.5 * total + along
        return out


ScannedFunctions = PoseFunctions | Harmonics


def spread(position: np.ndarray, count: int) -> csr_array:
    """(P, count): the window about each position (P,), in steps of the grid, at the nodes 0 to count - 1."""
    left = np.ceil(position - TAPS / 2).astype(int)
    nodes = left[:, None] + np.arange(TAPS)
    off = 2 * (nodes - position[:, None]) / TAPS
    window = i0(SHAPE * np.sqrt(np.maximum(1 - off**2, 0.0)))
    ends = TAPS * np.arange(len(position) + 1)
    return csr_array((window.ravel(), nodes.ravel(), ends), shape=(len(position), count))


def window_spectrum(phase: np.ndarray) -> np.ndarray:
    """The window's sum over the grid with a phase (H,) rad that grows by so much from one node to the next."""
    root = np.sqrt(SHAPE**2 - (phase * TAPS / 2) ** 2)
    return TAPS * np.sinh(root) / root


def angle_of_harmonics(columns: Sequence[Column]) -> str | None:
    """The covariate of which columns are the sine and the cosine; None if they are something else."""
    products = [product for column in columns for product in column]
    plain = all(np.ndim(p.factor) == 0 and p.factor == 1.0 and len(p.functions) == 1 for p in products)
    if len(columns) != 2 or len(products) != 2 or not plain:
        return None
    of_sine, of_cosine = (p.functions[0] for p in products)
    same = of_sine.covariate == of_cosine.covariate and of_sine.numbers[0] is of_cosine.numbers[0]
    return of_sine.covariate if same and (of_sine.kind, of_cosine.kind) == ("sin", "cos") else None


def covariates(linear: LinearProblem) -> Context:
    """Covariates of the recording, computed once for a linearisation."""
    return linear.computed_once("covariates", lambda: Context(linear.obs, linear.state, linear.prediction))


def candidate_parts(linear: LinearProblem, candidate: Candidate, hyper: float | None = None) -> list[Part]:
    """What a candidate displaces at a value of its hyper-parameter."""
    return parts_of(candidate, covariates(linear), hyper)


def candidate_columns(linear: LinearProblem, candidate: Candidate, hyper: float | None = None) -> np.ndarray:
    """(M, R, k): change of the prediction by each coefficient of a candidate."""
    return linear.columns(candidate_parts(linear, candidate, hyper))


def scanned_functions(linear: LinearProblem, candidate: Candidate, values: np.ndarray) -> ScannedFunctions:
    """The functions of a candidate with components, at values (H,) of its hyper-parameter. The grid is scanned many times: its functions
    are kept.
    """
    if candidate.hyper is None or values is not candidate.hyper.values:
        return functions_at(candidate, covariates(linear), values)
    return linear.computed_once(("functions", candidate.key), lambda: functions_at(candidate, covariates(linear), values))


def functions_at(candidate: Candidate, here: Context, values: np.ndarray) -> ScannedFunctions:
    """The same, of poses with these covariates."""
    angle = angle_of_harmonics(candidate.functions(values))
    return Harmonics(here.value(angle), values) if angle is not None else PoseFunctions(functions_of(candidate, here, values))
