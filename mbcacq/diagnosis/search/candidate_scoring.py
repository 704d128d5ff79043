"""What every candidate would gain: whitened rows with all free geometry projected out, and fast scans over hyper-parameters.

Gains are differences of weighted squares (of chi2 if the noise is right), each after the geometry and the station poses, and
whatever has been adopted, were refitted together with the candidate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtri

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.variance_components import orthogonal, pose_sums
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.search.batch_scoring import BatchScoring
from mbcacq.diagnosis.search.projected_solve import prior_weight, solve_block, solve_blocks
from mbcacq.effects.effect import Candidate


@dataclass(frozen=True)
class ScoredCandidate:
    """A candidate at one value of its hyper-parameter: gain in chi2, its k coefficients and their covariance."""

    candidate: Candidate
    hyper: float | None
    gain: float
    k: int
    coefficients: np.ndarray
    covariance: np.ndarray

    @property
    def fitted(self) -> tuple[Candidate, np.ndarray, np.ndarray]:
        return self.candidate, self.coefficients, self.covariance


class CandidateScoring:
    """Whitened problem under a noise model. adopted() gives a screen that projects out more; it borrows what this one has computed."""

    def __init__(self, linear: LinearProblem, noise: NoiseEstimate, beside: tuple[np.ndarray, np.ndarray] | None = None):
        """beside: more columns (M, R, k) with their prior sigma (k,), to be projected out as geometry is."""
        self.linear, self.noise = linear, noise
        self.whiten = linear.whitener(noise)
        columns, sigma, _ = linear.nuisance()
        Z = self.whiten(columns) * sigma
        if beside is not None:
            Z = np.concatenate([Z, self.whiten(beside[0]) * beside[1]], axis=1)
        # With priors Q'Q < I, and x'(I - QQ')y is what they allow: the metric of all gains.
        self.Q, self.log_det = orthogonal(Z)
        self.r0 = self.whiten(linear.residual)
        self.r = self.r0 - self.Q @ (self.Q.T @ self.r0)
        self.pose_of_row, self.by_pose = pose_sums(linear)
        self.dof = float(linear.keep.sum() * linear.width - np.sum(self.Q * self.Q))
        self.more, self.taken = np.zeros((len(self.r0), 0)), np.zeros(0)
        self._units: dict[tuple[str, int, int], np.ndarray] = {}
        self._tests: dict[tuple, tuple] = {}
        self._scans: dict[tuple, tuple] = {}
        self._reduced: dict[tuple, tuple] = {}
        self._reduced_more: dict[tuple, np.ndarray] = {}
        self._benches: list[BatchScoring] = []

    def adopted(self, blocks: list[tuple[np.ndarray, np.ndarray]]) -> CandidateScoring:
        """A screen that also projects out whitened blocks (rows, k), each with the prior weight (k,) of its coefficients."""
        out = object.__new__(CandidateScoring)
        out.__dict__.update(self.__dict__)
        out._reduced_more = {}
        for X, weight in blocks:
            Y = X - self.Q @ (self.Q.T @ X) - out.more @ (out.more.T @ X)
            S = X.T @ Y + np.diag(weight)
            L = np.linalg.cholesky(S + 1e-12 * np.diag(np.sum(X * X, axis=0)))
            out.more = np.concatenate([out.more, Y @ dtrtri(L, lower=1)[0].T], axis=1)
        out.taken = out.more.T @ self.r0
        out.r = self.r0 - self.Q @ (self.Q.T @ self.r0) - out.more @ out.taken
        return out

    @property
    def chi2(self) -> float:
        return float(self.r0 @ self.r)

    @property
    def all_projected(self) -> np.ndarray:
        """(rows, z) everything that is projected out."""
        return np.concatenate([self.Q, self.more], axis=1)

    def block(self, candidate: Candidate, hyper: float | None) -> np.ndarray:
        """Whitened columns (rows, k) of a candidate."""
        return self.prepared(candidate, hyper)[0]

    def prepared(self, candidate: Candidate, hyper: float | None) -> tuple:
        """Whitened columns X, X'X and X'r with geometry projected out; adopted blocks left out."""
        key = (candidate.key, hyper)
        if key not in self._tests:
            X = self.whiten(self.linear.columns(candidate.build(hyper)))
            taken = self.Q.T @ X
            r = self.r0 - self.Q @ (self.Q.T @ self.r0)
            self._tests[key] = X, X.T @ X - taken.T @ taken, X.T @ r
            if len(self._tests) > 3000:
                self._tests.pop(next(iter(self._tests)))
        return self._tests[key]

    def test(self, candidate: Candidate, hyper: float | None = None) -> ScoredCandidate:
        X, S, b = self.prepared(candidate, hyper)
        if self.more.shape[1]:
            taken = self.more.T @ X
            S, b = S - taken.T @ taken, b - taken.T @ self.taken
        gain, coefficients, covariance = solve_block(S, b, np.sum(X * X, axis=0), prior_weight(candidate))
        return ScoredCandidate(candidate, hyper, gain, len(b), coefficients, covariance)

    def best_fixed(self, candidates: list[Candidate]) -> dict[str, tuple[float | None, float]]:
        """Of the candidates that need no scan: key -> best value of the hyper-parameter, and the gain there."""
        bench = next((b for b in self._benches if b.fixed.candidates is candidates), None)
        if bench is None:
            bench = BatchScoring.of(candidates, self.linear, self.whiten, self.Q, self.r0 - self.Q @ (self.Q.T @ self.r0))
            self._benches.append(bench)
        return bench.best(self.more, self.taken)

    # Scans --------------------------------------------------------------------------------------------------------

    def unit(self, key: tuple[str, int, int]) -> np.ndarray:
        if key not in self._units:
            self._units[key] = self.whiten(self.linear.unit(*key)[:, :, None])[:, 0]
        return self._units[key]

    def reduced(self, components: tuple[tuple[str, int, int], ...]):
        """Sums over each pose: b (P, c), A (P, c, c), C (P, c, z) of the unit columns of some components; adopted blocks left out."""
        if components not in self._reduced:
            E = np.stack([self.unit(key) for key in components], axis=1)
            r = self.r0 - self.Q @ (self.Q.T @ self.r0)
            products = self.products(E, np.concatenate([self.Q, E, r[:, None]], axis=1))
            z = self.Q.shape[1]
            self._reduced[components] = products[:, :, -1], products[:, :, z:-1], products[:, :, :z]
        return self._reduced[components]

    def reduced_more(self, components: tuple[tuple[str, int, int], ...]) -> np.ndarray:
        """(P, c, z) of the adopted blocks."""
        if components not in self._reduced_more:
            self._reduced_more[components] = self.products(np.stack([self.unit(key) for key in components], axis=1), self.more)
        return self._reduced_more[components]

    def products(self, E: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """(P, c, z): E'Y over the rows of each pose; E (rows, c), Y (rows, z)."""
        linear, out = self.linear, np.zeros((self.linear.obs.n_poses, E.shape[1], Y.shape[1]))
        E, Y = E.reshape(-1, linear.width, E.shape[1]), Y.reshape(-1, linear.width, Y.shape[1])
        for index, _ in self.whiten.groups:
            rows = len(index), index.shape[1] * linear.width, -1
            out[linear.obs.pose[index[:, 0]]] = np.swapaxes(E[index].reshape(rows), 1, 2) @ Y[index].reshape(rows)
        return out

    def scan(self, candidate: Candidate, values: np.ndarray | None = None) -> np.ndarray:
        """Gain (H,) of a separable candidate at each hyper value."""
        key = candidate.key if values is None else None
        values = candidate.hyper.values if values is None else values
        return self.gains(candidate.separable, candidate.functions, values, prior_weight(candidate), key)

    def gains(
        self,
        components: tuple[tuple[str, int, int], ...],
        functions,
        values: np.ndarray,
        weight: np.ndarray | float = 0.0,
        key: str | None = None,
    ) -> np.ndarray:
        """Gain (H,) of the products of some components of a place with functions(values) (H, P, f). key: remember under this name."""
        out = []
        chunk = max(1, int(2e6 // max(self.linear.obs.n_poses, 1)))
        c = len(components)
        for start in range(0, len(values), chunk):
            here = values if len(values) <= chunk else values[start : start + chunk]
            flat, S, xr, raw = self._normal(components, functions, here, key and (key, start))
            if self.more.shape[1]:
                H, f = len(S), S.shape[1] // c
                extra = (flat @ self.reduced_more(components).reshape(len(self.reduced_more(components)), -1)).reshape(H, f, c, -1)
                extra = extra.transpose(0, 2, 1, 3).reshape(H, c * f, -1)
                S, xr = S - extra @ np.swapaxes(extra, 1, 2), xr - extra @ self.taken
            out.append(solve_blocks(S, xr, raw, weight))
        return np.concatenate(out)

    def _normal(self, components, functions, values, key):
        """Functions (H f, P), normal matrices (H, k, k), right-hand sides (H, k) and raw squares (H, k), geometry projected out."""
        if key is not None and key in self._scans:
            return self._scans[key]
        b, A, C = self.reduced(components)
        P, c = b.shape
        F = functions(values)
        H, _, f = F.shape
        flat = np.ascontiguousarray(np.swapaxes(F, 1, 2)).reshape(H * f, P)
        xr = (flat @ b).reshape(H, f, c).transpose(0, 2, 1).reshape(H, c * f)
        xq = (flat @ C.reshape(P, -1)).reshape(H, f, c, -1).transpose(0, 2, 1, 3).reshape(H, c * f, -1)
        xx = np.empty((H, c, f, c, f))
        for i in range(f):
            for j in range(i + 1):
                block = ((F[:, :, i] * F[:, :, j]) @ A.reshape(P, c * c)).reshape(H, c, c)
                xx[:, :, i, :, j] = block
                xx[:, :, j, :, i] = block
        xx = xx.reshape(H, c * f, c * f)
        result = flat, xx - xq @ np.swapaxes(xq, 1, 2), xr, np.diagonal(xx, axis1=1, axis2=2)
        if key is not None and flat.size < 1e6:
            self._scans[key] = result
        return result
