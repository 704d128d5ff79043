"""A-optimality and D-optimality of a set of poses, and what one more or one fewer pose changes in them.

Each pose is a block B (r, G): its whitened rows by all G unknowns (arm, hand-eye, six of each station). With M the information so far
and C its inverse, a pose turns C into C - C B' inv(I + B C B') B C; what that gains is computed for many poses in one batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class AOptimality:
    """Mean variance of what ``target`` = rows' rows (G, G) stands for: the trace of target C."""

    target: np.ndarray

    def value(self, C: np.ndarray) -> float:
        """The criterion of a covariance C (G, G); the smaller the better."""
        return float(np.sum(self.target * C))

    def gains(self, C: np.ndarray, B: np.ndarray, sign: float) -> np.ndarray:
        """(P,) decrease of ``value`` by adding (sign 1) or taking away (sign -1) each block of B (P, r, G)."""
        BC = B @ C
        S = _schur(B, C, sign)
        gain = sign * np.trace(np.linalg.solve(S, BC @ self.target @ np.swapaxes(BC, 1, 2)), axis1=1, axis2=2)
        return _spared(gain, S, sign)


@dataclass(frozen=True)
class DOptimality:
    """Volume of the confidence region of the first ``own`` unknowns, as the log determinant of their covariance."""

    own: int

    def value(self, C: np.ndarray) -> float:
        return float(np.linalg.slogdet(C[: self.own, : self.own])[1])

    def gains(self, C: np.ndarray, B: np.ndarray, sign: float) -> np.ndarray:
        """By the determinant lemma: the volume of the own unknowns is that of all, less that of the stations with the own ones known."""
        S, rest = _schur(B, C, sign), slice(self.own, None)
        inner = np.linalg.inv(np.linalg.inv(C)[rest, rest]) if C.shape[0] > self.own else np.zeros((0, 0))
        T = _schur(B[..., rest], inner, sign)
        return _spared(np.linalg.slogdet(S)[1] - np.linalg.slogdet(T)[1], S, sign)


Criterion = AOptimality | DOptimality


def updated_covariance(C: np.ndarray, B: np.ndarray, sign: float) -> np.ndarray:
    """Covariance after adding (1) or taking away (-1) a block B (r, G), symmetric to the last digit."""
    BC = B @ C
    out = C - sign * BC.T @ np.linalg.solve(np.eye(len(B)) + sign * BC @ B.T, BC)
    return 0.5 * (out + out.T)


def _schur(B: np.ndarray, C: np.ndarray, sign: float) -> np.ndarray:
    """(P, r, r): I + sign B C B'."""
    return np.eye(B.shape[1]) + sign * (B @ C) @ np.swapaxes(B, 1, 2)


def _spared(gain: np.ndarray, S: np.ndarray, sign: float) -> np.ndarray:
    """Gains, -inf for a pose that cannot be taken away because it alone carries a direction."""
    return np.where(np.linalg.eigvalsh(S)[:, 0] > 1e-9, gain, -np.inf) if sign < 0 else gain
