"""Score test of a step at every moment of a recording: what columns that act from a pose on would gain, without a refit.

The Gram of the steps follows from sums over the poses behind each moment. Parameters and
stations take off ``w C w'`` and ``v v'``, with w and v the products of a step with their columns; both are cumulative sums (Rao 1948).

What is found among all moments and kinds is judged by an e-value: the mean, over kinds, moments and sizes, of Bayes factors with Zellner's
prior. Its expectation is 1 where nothing changed, so that it exceeds 1/a with probability a at most, however many moments are looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from mbcacq.estimation.solution import Solution

SIZES = (9.0, 81.0, 729.0)  # variance of a step over that of its estimate: steps of 3, 9 and 27 of their standard deviations
SINGULAR = 1e-6  # share of a column's own information that must be left beside parameters and stations


@dataclass(frozen=True)
class Steps:
    """Steps of k columns at T moments.

    Attributes
    ----------
    rank : ndarray
        (T,) of the steps beside parameters and stations.
    gain : ndarray
        (T,) fall of chi square.
    right, root : ndarray
        (T, k) score and (T, k, k) F with F F' the covariance of the step.
    with_parameters : ndarray
        (T, k, g) products with the columns of the parameters, the stations taken out.
    """

    rank: np.ndarray
    gain: np.ndarray
    right: np.ndarray
    root: np.ndarray
    with_parameters: np.ndarray

    @property
    def log_bayes_factor(self) -> np.ndarray:
        """(T,) mean over ``SIZES``."""
        return np.where(self.rank > 0, logsumexp(self._by_size(slice(None)), axis=0) - np.log(len(SIZES)), -np.inf)

    def shrinkage(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean, at moments, of the factor g / (1 + g) by which the prior draws a step to zero, and of its square."""
        each, factor = self._by_size(at), np.array(SIZES) / (1 + np.array(SIZES))
        share = np.exp(each - logsumexp(each, axis=0))
        return factor @ share, factor**2 @ share

    def _by_size(self, at: slice | np.ndarray) -> np.ndarray:
        g = np.array(SIZES)[:, None]
        return 0.5 * self.gain[at] * g / (1 + g) - 0.5 * self.rank[at] * np.log1p(g)

    def estimate(self, t: int) -> tuple[np.ndarray, np.ndarray]:
        """Step (k,) at a moment and its covariance (k, k)."""
        covariance = self.root[t] @ self.root[t].T
        return covariance @ self.right[t], covariance


class StepTest:
    """A solved linear problem with its poses in the order of measuring.

    Moment t, 0 to P, is before the t-th measured pose. step: (g,) from the estimate to the best fit under the solution's noise.
    """

    def __init__(self, solution: Solution):
        self.solution = solution
        rows, normal, g = solution.lineariser.rows, solution.normal, solution.normal.size
        self.order = solution.lineariser.obs.measuring_order
        back = np.empty(rows.n_poses, int)
        back[rows.order] = np.arange(rows.n_poses)
        self.turn = back[self.order]
        X, self.run = solution.X[self.turn], rows.run[self.turn]
        self.y = X[..., g : g + 6] @ normal.station_root[self.run]
        self.reduced = X[..., :g] - self.y @ normal.reduced[self.run]
        self.covariance = np.linalg.inv(normal.information)
        self.step = self.covariance @ normal.gradient
        self.residual = X[..., -1] - self.reduced @ self.step - np.einsum("pmk,pk->pm", self.y, normal.station_b[self.run])

    def of(self, columns: np.ndarray) -> Steps:
        """Steps of columns (M, R, k) of the centres."""
        solution = self.solution
        Z = solution.whitening(solution.lineariser.rows.pad(solution.lineariser.weighted(columns)))[self.turn]
        Zt = np.swapaxes(Z, 1, 2)
        right, square, with_g = (_from_the_end(Zt @ other) for other in (self.residual[..., None], Z, self.reduced))
        left = square - with_g @ self.covariance @ np.swapaxes(with_g, 1, 2) - self._with_stations(Zt @ self.y)
        size = np.sqrt(np.maximum(np.einsum("tkk->tk", square), 1e-300))
        value, vector = np.linalg.eigh(left / size[:, :, None] / size[:, None, :])
        kept = value > SINGULAR
        root = vector / size[:, :, None] * (kept / np.sqrt(np.where(kept, value, 1.0)))[:, None, :]
        gain = np.sum(np.einsum("tkj,tk->tj", root, right[..., 0]) ** 2, axis=1)
        return Steps(kept.sum(axis=1), gain, right[..., 0], root, with_g)

    def _with_stations(self, per_pose: np.ndarray) -> np.ndarray:
        """(P + 1, k, k): sum of v v' over the stations, v the sum of (k, 6) over the poses behind each moment at one of them."""
        change = np.empty((len(per_pose), *[per_pose.shape[1]] * 2))
        for s in range(len(self.solution.normal.station_root)):
            here = self.run == s
            total = _from_the_end(per_pose[here])
            square = total @ np.swapaxes(total, 1, 2)
            change[here] = square[:-1] - square[1:]
        return _from_the_end(change)


def _from_the_end(per_pose: np.ndarray) -> np.ndarray:
    """(P + 1, ...) sums over the t-th and all later poses."""
    total = np.zeros((len(per_pose) + 1, *per_pose.shape[1:]))
    total[:-1] = np.cumsum(per_pose[::-1], axis=0)[::-1]
    return total
