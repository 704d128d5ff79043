"""What every candidate would gain: whitened rows with all free geometry projected out, and fast scans over hyper-parameters.

Gains are differences of weighted squares (of chi2 if the noise is right), each after the geometry and the station poses, and
whatever has been adopted, were refitted together with the candidate.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.diagnosis.linear import Linear
from mbcacq.diagnosis.noise import pose_sums
from mbcacq.diagnosis.whitening import Noise
from mbcacq.physics.effect import Candidate

LARGEST = 30.0
SMALLEST_SHARE = 1e-6  # of a column's square that must survive the projection


@dataclass(frozen=True)
class Scored:
    """A candidate at one value of its hyper-parameter: gain in chi2, its k coefficients and their covariance."""

    candidate: Candidate
    hyper: float | None
    gain: float
    k: int
    coefficients: np.ndarray
    covariance: np.ndarray
    curve: np.ndarray | None = field(default=None, repr=False)


class Screen:
    """Whitened problem under a noise model. adopt() adds columns to what is projected out."""

    def __init__(self, linear: Linear, noise: Noise):
        self.linear, self.noise = linear, noise
        self.blocks: dict[tuple[str, float | None], np.ndarray] = {}
        self.whiten = linear.whitener(noise)
        columns, self.sigma, self.layout = linear.nuisance()
        self.Z = self.whiten(columns) * self.sigma
        L = np.linalg.cholesky(self.Z.T @ self.Z + np.eye(self.Z.shape[1]))
        Q = np.linalg.solve(L, self.Z.T).T
        # A prior makes Q'Q < I; project out twice would be wrong, so keep the metric: x'(I - QQ')y is what priors allow.
        self.Q = Q
        self.r0 = self.whiten(linear.residual)
        self.r = self.r0 - Q @ (Q.T @ self.r0)
        self.pose_of_row, self.by_pose = pose_sums(linear)
        self._units: dict[tuple[str, int, int], np.ndarray] = {}
        self._cache: dict[tuple[tuple[str, int, int], ...], tuple] = {}
        self.chi2_base = float(self.r0 @ self.r)
        self.dof = float(linear.keep.sum() * linear.width - np.sum(Q * Q))

    def adopted(self, blocks: list[tuple[np.ndarray, np.ndarray]]) -> Screen:
        """A screen that also projects out whitened blocks (rows, k), each with the prior weight (k,) of its coefficients."""
        out = object.__new__(Screen)
        out.__dict__.update(self.__dict__)
        out._cache = {}
        for X, weight in blocks:
            Y = X - out.Q @ (out.Q.T @ X)
            S = X.T @ Y + np.diag(weight)
            L = np.linalg.cholesky(S + 1e-12 * np.diag(np.sum(X * X, axis=0)))
            out.Q = np.concatenate([out.Q, np.linalg.solve(L, Y.T).T], axis=1)
        out.r = out.r0 - out.Q @ (out.Q.T @ out.r0)
        return out

    @property
    def chi2(self) -> float:
        return float(self.r0 @ self.r)

    def block(self, candidate: Candidate, hyper: float | None) -> np.ndarray:
        """Whitened columns (rows, k) of a candidate; kept for candidates without hyper-parameter."""
        key = (candidate.key + f":{candidate.k}", hyper)
        if key in self.blocks:
            return self.blocks[key]
        out = self.whiten(self.linear.columns(candidate.build(hyper)))
        if hyper is None:
            self.blocks[key] = out
        return out

    def test(self, candidate: Candidate, hyper: float | None = None) -> Scored:
        return self.solve(candidate, hyper, self.block(candidate, hyper))

    def solve(self, candidate: Candidate, hyper: float | None, X: np.ndarray) -> Scored:
        taken = self.Q.T @ X
        S = X.T @ X - taken.T @ taken
        b = X.T @ self.r
        raw = np.sum(X * X, axis=0)
        gain, coefficients, covariance = solve_block(S, b, raw, prior_weight(candidate))
        return Scored(candidate, hyper, gain, len(b), coefficients, covariance)

    # Scans --------------------------------------------------------------------------------------------------------

    def unit(self, key: tuple[str, int, int]) -> np.ndarray:
        if key not in self._units:
            self._units[key] = self.whiten(self.linear.unit(*key)[:, :, None])[:, 0]
        return self._units[key]

    def reduced(self, components: tuple[tuple[str, int, int], ...]):
        """Sums over each pose: b (P, c), A (P, c, c), C (P, c, z) of the unit columns of some components."""
        if components not in self._cache:
            E = np.stack([self.unit(key) for key in components], axis=1)
            b = self.by_pose(E * self.r[:, None])
            A = self.by_pose(E[:, :, None] * E[:, None, :])
            C = np.stack([self.by_pose(E[:, c, None] * self.Q) for c in range(E.shape[1])], axis=1)
            self._cache[components] = b, A, C
        return self._cache[components]

    def scan(self, candidate: Candidate, values: np.ndarray | None = None) -> np.ndarray:
        """Gain (H,) of a separable candidate at each hyper value."""
        values = candidate.hyper.values if values is None else values
        return self.gains(candidate.separable, candidate.functions, values, prior_weight(candidate))

    def gains(self, components: tuple[tuple[str, int, int], ...], functions, values: np.ndarray, weight: np.ndarray | float = 0.0) -> np.ndarray:
        """Gain (H,) of the products of some components of a place with functions(values) (H, P, f)."""
        b, A, C = self.reduced(components)
        P, c = b.shape
        A, C = A.reshape(P, c * c), C.reshape(P, -1)
        used = np.flatnonzero(np.any(A != 0, axis=1))
        gains = []
        chunk = max(1, int(4e6 // max(P, 1)))
        for start in range(0, len(values), chunk):
            F = functions(values[start:start + chunk])[:, used]
            H, _, f = F.shape
            flat = np.ascontiguousarray(np.swapaxes(F, 1, 2)).reshape(H * f, len(used))
            xr = (flat @ b[used]).reshape(H, f, c).transpose(0, 2, 1).reshape(H, c * f)
            xq = (flat @ C[used]).reshape(H, f, c, -1).transpose(0, 2, 1, 3).reshape(H, c * f, -1)
            xx = np.empty((H, c, f, c, f))
            for i in range(f):
                for j in range(i + 1):
                    block = ((F[:, :, i] * F[:, :, j]) @ A[used]).reshape(H, c, c)
                    xx[:, :, i, :, j] = block
                    xx[:, :, j, :, i] = block
            xx = xx.reshape(H, c * f, c * f)
            raw = np.diagonal(xx, axis1=1, axis2=2)
            S = xx - xq @ np.swapaxes(xq, 1, 2)
            gains.append(solve_blocks(S, xr, raw, weight))
        return np.concatenate(gains)


def prior_weight(candidate: Candidate) -> np.ndarray:
    """(k,) inverse variance of the coefficients: an effect thirty times its typical size is not believed."""
    return 1.0 / (LARGEST * candidate.typical) ** 2


def solve_block(S: np.ndarray, b: np.ndarray, raw: np.ndarray, weight: np.ndarray | float = 0.0) -> tuple[float, np.ndarray, np.ndarray]:
    """Gain, coefficients, covariance of a projected normal matrix; directions that the projection destroyed are held at zero."""
    S = S + np.diag(np.broadcast_to(weight, len(b)))
    size = np.sqrt(np.maximum(raw, 1e-300))
    w, V = np.linalg.eigh(S / np.outer(size, size))
    inverse = np.where(w > SMALLEST_SHARE, 1.0 / np.maximum(w, SMALLEST_SHARE), 0.0)
    pseudo = (V * inverse) @ V.T / np.outer(size, size)
    coefficients = pseudo @ b
    return float(b @ coefficients), coefficients, pseudo


def solve_blocks(S: np.ndarray, b: np.ndarray, raw: np.ndarray, weight: np.ndarray | float = 0.0) -> np.ndarray:
    """Gains (H,) of many blocks (H, k, k), (H, k)."""
    k = b.shape[1]
    S = S + np.diag(np.broadcast_to(weight, k))
    size = np.sqrt(np.maximum(raw, 1e-300))
    scaled, target = S / (size[:, :, None] * size[:, None, :]), b / size
    if S.shape[1] == 1:
        good = scaled[:, 0, 0] > SMALLEST_SHARE
        return np.where(good, target[:, 0] ** 2 / np.maximum(scaled[:, 0, 0], SMALLEST_SHARE), 0.0)
    w, V = np.linalg.eigh(scaled)
    along = np.einsum("hij,hi->hj", V, target)
    return np.sum(np.where(w > SMALLEST_SHARE, along**2 / np.maximum(w, SMALLEST_SHARE), 0.0), axis=1)
