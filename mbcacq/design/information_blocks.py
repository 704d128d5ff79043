"""Whitened rows of every pose: of all that geometry absorbs, and of the effects that are to be seen or told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.design.options import OPTIONS
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.whitening import Whitening

ROWS = 12  # combinations of a pose's coordinates that are kept, largest first: six of a rigid view, and distortion


@dataclass(frozen=True, eq=False)
class InformationBlocks:
    """Z (P, r, G): of the free parameters in units of their prior sigma, then of six of each station; E (P, r, K): of effects. Rows of one
    pose are independent of variance one.
    """

    Z: np.ndarray
    E: np.ndarray

    @classmethod
    def of(cls, linear: LinearProblem, columns: np.ndarray, noise: Noise, keep: np.ndarray, rows: int = ROWS) -> InformationBlocks:
        """columns (M, R, K): displacements by effects; keep (M,) bool: centres that take part; rows: of a pose. In the order of the
        observations' poses."""
        order = linear.rows.order
        whiten = Whitening(linear.rows, linear.joint, noise, keep.astype(float), np.ones(len(order)))
        g, stations = linear.geometry.shape[2], linear.rows.stations
        # Places are vaguely known: what nothing is known of would spoil the last digits of all else.
        placed = linear.station * np.array(OPTIONS.station_sigmas)
        together = np.concatenate([linear.geometry * linear.sigma, placed, columns], axis=2)
        X = _compressed(whiten(linear.rows.pad(together)), rows)
        Z = np.zeros((*X.shape[:2], g + 6 * len(stations)))
        Z[:, :, :g] = X[:, :, :g]
        own = g + 6 * np.searchsorted(stations, linear.obs.station[order])[:, None] + np.arange(6)
        np.put_along_axis(Z, np.broadcast_to(own[:, None], (*X.shape[:2], 6)), X[:, :, g : g + 6], axis=2)
        in_order = np.argsort(order)
        return cls(Z[in_order], X[in_order][:, :, g + 6 :])

    def select(self, poses: np.ndarray) -> InformationBlocks:
        """The blocks of some poses."""
        return InformationBlocks(self.Z[poses], self.E[poses])


def _compressed(X: np.ndarray, rows: int) -> np.ndarray:
    """(P, rows, C) of rows (P, B R, C), with the same products of columns as far as the largest combinations of rows go."""
    if X.shape[1] <= rows:
        return X
    size = np.sqrt(np.maximum(np.sum(X * X, axis=(0, 1)), 1e-300))  # every column counts alike
    scaled = X / size
    _, vectors = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2))
    return np.swapaxes(vectors[:, :, -rows:], 1, 2) @ X
