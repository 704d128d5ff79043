"""The projected problem: whitened rows with all free geometry projected out, in which every candidate's gain is scored.

Gains are differences of weighted squares (of chi2 if the noise is right), each after the geometry, the station poses and whatever the
problem is conditioned on were refitted together with the candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from mbcacq.diagnosis.search.effect_columns import ScannedFunctions, candidate_columns, scanned_functions
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.normal_equations import inverse_of_lower
from mbcacq.estimation.options import Noise
from mbcacq.estimation.terms import PER_POSE
from mbcacq.estimation.whitening import CentreWhitening
from mbcacq.model.computed_once import ComputedOnce


def ridge_projection(own: np.ndarray, rows_of: Sequence[slice | np.ndarray], shared: np.ndarray) -> tuple[np.ndarray, float]:
    """Q (rows, z) with Q Q' = Z (Z'Z + I)^-1 Z', what columns with coefficients of unit prior variance absorb, and log det(Z'Z + I).

    The z columns Z are those of every station, six each, and the g of ``shared`` (rows, g), which all rows share. own: (rows, 6) columns of
    each row's own station, which vanish at the rows of all others; rows_of: the rows of each station.
    """
    first, g = own.shape[1] * len(rows_of), shared.shape[1]
    Q, beyond, log_det = np.zeros((len(own), first + g)), shared.copy(), 0.0
    normal = np.zeros((g, g))
    for j, rows in enumerate(rows_of):
        inverse, log = _inverse_root(own[rows].T @ own[rows])
        here = own[rows] @ inverse.T
        absorbed = here.T @ shared[rows]
        beyond[rows] -= here @ absorbed
        # With R the inverse root, I - Q'Q = R R': what remains of the normal matrix is a sum of squares, which no rounding makes negative.
        held = inverse.T @ absorbed
        normal += held.T @ held
        Q[rows, 6 * j : 6 * j + 6] = here
        log_det += log
    inverse, log = _inverse_root(normal + beyond.T @ beyond)
    Q[:, first:] = beyond @ inverse.T
    return Q, log_det + log


def _inverse_root(normal: np.ndarray) -> tuple[np.ndarray, float]:
    """R (k, k), lower triangular, with R (I + normal) R' = I, and the log determinant of I + normal."""
    factor = np.linalg.cholesky(normal + np.eye(len(normal)))
    return inverse_of_lower(factor), 2 * float(np.log(np.diag(factor)).sum())


class FixedBlocks:
    """The candidates whose columns need no scan, each at every value of its hyper-parameter.

    entries: (candidate, value); columns (M, R, K): all of theirs. sizes: of those with k coefficients, which entries (n,), which columns
    (n, k).
    """

    def __init__(self, candidates: list[Candidate], linear: LinearProblem):
        self.entries = [(c, h) for c in candidates if not c.components for h in (c.hyper.values if c.hyper else (None,))]
        each = [candidate_columns(linear, c, h) for c, h in self.entries]
        self.columns = np.concatenate(each, axis=2) if each else np.zeros((*linear.residual.shape, 0))
        widths = np.array([e.shape[2] for e in each], dtype=int)
        starts = np.cumsum(widths) - widths
        self.sizes = []
        for k in np.unique(widths):
            chosen = np.flatnonzero(widths == k)
            self.sizes.append((chosen, starts[chosen][:, None] + np.arange(k)))

    @staticmethod
    def of(candidates: list[Candidate], linear: LinearProblem) -> FixedBlocks:
        """Made once for a linearisation."""
        return linear.computed_once(candidate_keys(candidates), lambda: FixedBlocks(candidates, linear))


def candidate_keys(candidates: list[Candidate]) -> tuple[str, ...]:
    return tuple(c.key for c in candidates)


Blocks = list[tuple[np.ndarray, np.ndarray]]
UnitKey = tuple[str, int, int]  # location, index, component
MOST_KEPT = 3000  # candidates whose products are kept
ROUNDING = 1e-11  # share of a squared displacement that is left where two displacements cancel
NOISES = 64  # draws of noise, by which the median of a largest of many scores is known: it need not be exact


@dataclass(frozen=True, eq=False)
class CandidateScoring:
    """The projected problem under one noise model, and what it is conditioned on.

    whiten: to rows of unit variance. Q (rows, z): basis of what geometry absorbs, log_det its log determinant; its first columns are of
    the stations, six of each, and vanish at all others. r0, r (rows,): whitened
    residual before and after all projections. dof: degrees of freedom with geometry alone. conditioned (rows, a): basis of what is
    projected out besides geometry; along (a,): the residual along it. known: products with geometry alone projected out, which every
    conditioning of the problem shares; known_beside: those with all that it is conditioned on.
    """

    linear: LinearProblem
    noise: Noise
    whiten: CentreWhitening
    Q: np.ndarray
    log_det: float
    r0: np.ndarray
    r: np.ndarray
    dof: float
    conditioned: np.ndarray
    along: np.ndarray
    known: ComputedOnce = field(default_factory=ComputedOnce, repr=False)
    known_beside: ComputedOnce = field(default_factory=ComputedOnce, repr=False)

    def __reduce__(self) -> tuple:
        """Without what is computed when first asked for."""
        kept = {one.name: getattr(self, one.name) for one in fields(self) if one.default_factory is MISSING}
        return partial(CandidateScoring, **kept), ()

    @classmethod
    def of(cls, linear: LinearProblem, noise: Noise, nuisance: tuple[np.ndarray, np.ndarray] | None = None) -> CandidateScoring:
        """nuisance: more columns (M, R, k) with their prior sigma (k,), to be projected out as geometry is."""
        whiten = linear.whitener(noise)
        further = [] if nuisance is None else [nuisance[0] * nuisance[1]]
        columns = whiten(np.concatenate([linear.own_station, linear.geometry * linear.sigma, *further, linear.residual[..., None]], axis=2))
        r0 = columns[:, -1].copy()
        # With priors Q'Q < I, and x'(I - QQ')y is what they allow: the metric of all gains.
        Q, log_det = ridge_projection(columns[:, :6], linear.rows_of_stations, columns[:, 6:-1])
        dof = float(linear.keep.sum() * linear.width - np.sum(Q * Q))
        r, nothing = r0 - Q @ (Q.T @ r0), np.zeros((len(r0), 0))
        return cls(linear, noise, whiten, Q, log_det, r0, r, dof=dof, conditioned=nothing, along=np.zeros(0))

    def conditioned_on(self, blocks: list[tuple[np.ndarray, np.ndarray]]) -> CandidateScoring:
        """The problem that also projects out whitened blocks (rows, k), each with the prior weight (k,) of its coefficients."""
        basis = self.conditioned
        if blocks:
            X, weight = (np.concatenate(each, axis=-1) for each in zip(*blocks, strict=True))
            Y = X - self.Q @ self.absorbed(X)
            if basis.shape[1]:
                Y -= basis @ (basis.T @ X)
            S = X.T @ Y + np.diag(weight + 1e-12 * np.sum(X * X, axis=0))
            basis = np.concatenate([basis, Y @ inverse_of_lower(np.linalg.cholesky(S)).T], axis=1)
        along = basis.T @ self.r0
        r = self.beyond_geometry() - basis @ along
        return replace(self, conditioned=basis, along=along, r=r, known_beside=ComputedOnce())

    def absorbed(self, X: np.ndarray) -> np.ndarray:
        """Q'X (z, k) of whitened columns (rows, k), each station's columns of Q by its own rows."""
        first = 6 * len(self.linear.rows.stations)
        out = np.empty((self.Q.shape[1], X.shape[1]))
        out[first:] = self.Q[:, first:].T @ X
        for j, rows in enumerate(self.linear.rows_of_stations):
            out[6 * j : 6 * j + 6] = self.Q[rows, 6 * j : 6 * j + 6].T @ X[rows]
        return out

    @property
    def stations(self) -> list[np.ndarray]:
        """The poses of each station, in the order of the columns of Q."""
        station = self.linear.obs.station
        return [np.flatnonzero(station == s) for s in self.linear.rows.stations]

    def beyond_geometry(self) -> np.ndarray:
        """(rows,) whitened residual with geometry alone projected out."""
        return self.known("beyond geometry", lambda: self.r0 - self.Q @ (self.Q.T @ self.r0))

    @property
    def chi2(self) -> float:
        return float(self.r0 @ self.r)

    def block(self, candidate: Candidate, hyper: float | None) -> np.ndarray:
        """Whitened columns (rows, k) of a candidate."""
        return self.candidate_products(candidate, hyper)[0]

    def candidate_products(self, candidate: Candidate, hyper: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whitened columns X (rows, k), X'X and X'r with geometry alone projected out."""
        key, kept = (candidate.key, hyper), self.known("candidates", dict[tuple, Any])
        if key not in kept:
            X = self.whiten(candidate_columns(self.linear, candidate, hyper))
            absorbed = self.absorbed(X)
            kept[key] = X, X.T @ X - absorbed.T @ absorbed, X.T @ self.beyond_geometry()
            if len(kept) > MOST_KEPT:
                kept.pop(next(iter(kept)))
        return kept[key]

    def products_beside(self, candidate: Candidate, hyper: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same with all that the problem is conditioned on projected out."""
        X, S, b = self.candidate_products(candidate, hyper)
        absorbed = self.conditioned.T @ X
        return X, S - absorbed.T @ absorbed, b - absorbed.T @ self.along

    def batch(self, candidates: list[Candidate]) -> tuple[FixedBlocks, np.ndarray, Blocks]:
        """The candidates that need no scan: their whitened columns (rows, K), and of each size S (n, k, k) and b (n, k), with geometry
        alone projected out."""
        return self.known(("batch", candidate_keys(candidates)), lambda: self._batch(FixedBlocks.of(candidates, self.linear)))

    def _batch(self, fixed: FixedBlocks) -> tuple[FixedBlocks, np.ndarray, Blocks]:
        X = self.whiten(fixed.columns)
        absorbed, b = self.absorbed(X), X.T @ self.beyond_geometry()
        blocks = []
        for _, columns in fixed.sizes:
            own, gone = X.T[columns], absorbed.T[columns]
            blocks.append((own @ np.swapaxes(own, 1, 2) - gone @ np.swapaxes(gone, 1, 2), b[columns]))
        return fixed, X, blocks

    # Scans --------------------------------------------------------------------------------------------------------

    def unit(self, key: UnitKey) -> np.ndarray:
        """(rows,) whitened column of a unit of one component of one location."""
        return self.known(("unit", key), lambda: self.whiten(self.linear.unit(*key)[:, :, None])[:, 0])

    def twists(self, components: tuple[UnitKey, ...]) -> np.ndarray | None:
        """(P, c, 6) by which components of the arm or of the stations move each pose; None where one moves single centres."""
        if any(place not in PER_POSE for place, _, _ in components):
            return None
        return self.linear.computed_once(("twists", components), lambda: self._twists(components))

    def _twists(self, components: tuple[UnitKey, ...]) -> np.ndarray:
        out = np.stack([self.linear.twist(*key) for key in components], axis=1)
        # A turn about the line of two balls moves neither of them: what remains of it is rounding.
        rows = self.linear.rows
        gradient = rows.pad(self.linear.prediction.gradient)
        square = rows.per_pose(np.swapaxes(gradient, 1, 2) @ gradient)
        moved = np.einsum("pci,pij,pcj->pc", out, square, out)
        cancelled = moved < ROUNDING * np.einsum("pci,pii->pc", out**2, square)
        return np.where(cancelled[:, :, None], 0.0, out)

    def _sums(self, E: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums over each pose of products of whitened columns E (rows, c): with the residual, with each other, with Q."""
        products = self.whiten.pose_products(E, np.concatenate([self.Q, E, self.beyond_geometry()[:, None]], axis=1))
        z = self.Q.shape[1]
        return products[:, :, -1], products[:, :, z:-1], products[:, :, :z]

    def _moved(self) -> np.ndarray:
        """(rows, 6) whitened columns of a spatial twist of each pose by itself."""
        return self.known("moved", lambda: self.whiten(self.linear.prediction.gradient))

    def _units(self, components: tuple[UnitKey, ...]) -> np.ndarray:
        return np.stack([self.unit(key) for key in components], axis=1)

    def pose_products(self, components: tuple[UnitKey, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums over each pose: b (P, c), A (P, c, c), C (P, c, z) of the unit columns of some components, with geometry alone.

        What moves a pose as a whole is a combination of the sums of a twist.
        """
        return self.known(("sums", components), lambda: self._pose_products(components))

    def _pose_products(self, components: tuple[UnitKey, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        twists = self.twists(components)
        if twists is None:
            return self._sums(self._units(components))
        b, A, C = self.known("sums", lambda: self._sums(self._moved()))
        return (twists @ b[:, :, None])[:, :, 0], twists @ A @ np.swapaxes(twists, 1, 2), twists @ C

    def conditioned_pose_products(self, components: tuple[UnitKey, ...]) -> np.ndarray:
        """(P, c, a): the same with the basis of what the problem is conditioned on."""
        return self.known_beside(components, lambda: self._conditioned_pose_products(components))

    def _conditioned_pose_products(self, components: tuple[UnitKey, ...]) -> np.ndarray:
        twists = self.twists(components)
        if twists is None:
            return self.whiten.pose_products(self._units(components), self.conditioned)
        return twists @ self.known_beside("moved", lambda: self.whiten.pose_products(self._moved(), self.conditioned))

    def noise_draws(self) -> np.ndarray:
        """(rows, NOISES) draws of what is left of a residual without any effect once geometry is projected out: covariance I - QQ'."""
        return self.known("noise", self._noise_draws)

    def _noise_draws(self) -> np.ndarray:
        value, vectors = np.linalg.eigh(self.Q.T @ self.Q)
        drawn = np.random.default_rng(0).standard_normal((len(self.r0), NOISES))
        share = vectors / (1.0 + np.sqrt(np.maximum(1.0 - value, 0.0)))
        return drawn - self.Q @ (share @ (vectors.T @ (self.Q.T @ drawn)))

    def scores_of_noise(self, candidate: Candidate, values: Sequence[float | None]) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices (H, k, k) with geometry alone, and right-hand sides (H, k, NOISES) of recordings without any effect."""
        if not candidate.components:
            products = [self.candidate_products(candidate, value) for value in values]
            return np.array([S for _, S, _ in products]), np.array([X.T @ self.noise_draws() for X, _, _ in products])
        functions, S, _ = self._normal_matrices(candidate, np.array(values, dtype=float))
        by_pose = self.whiten.pose_products(self._units(candidate.components), self.noise_draws())
        return S, _by_column(functions, by_pose)

    def normal_matrices(self, candidate: Candidate, values: Sequence[float | None] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices (H, k, k) and right-hand sides (H, k) of a candidate beyond all that is projected out."""
        if not candidate.components:
            _, S, b = zip(*(self.products_beside(candidate, value) for value in values), strict=True)
            return np.array(S), np.array(b)
        functions, S, b = self._normal_matrices(candidate, np.asarray(values, dtype=float))
        if self.conditioned.shape[1]:
            absorbed = _by_column(functions, self.conditioned_pose_products(candidate.components))
            S, b = S - absorbed @ np.swapaxes(absorbed, 1, 2), b - absorbed @ self.along
        return S, b

    def _normal_matrices(self, candidate: Candidate, values: np.ndarray) -> tuple[ScannedFunctions, np.ndarray, np.ndarray]:
        """Functions, normal matrices (H, k, k) and right-hand sides (H, k), geometry projected out.

        Kept of the grid of each candidate, and of the last scan of other values: it is asked for again with draws of noise.
        """
        if candidate.hyper is not None and values is candidate.hyper.values:
            return self.known(("scan", candidate.key), lambda: self._scanned(candidate, values))
        return self.known.last("scan", (candidate.key, values.tobytes()), lambda: self._scanned(candidate, values))

    def _scanned(self, candidate: Candidate, values: np.ndarray) -> tuple[ScannedFunctions, np.ndarray, np.ndarray]:
        b, A, C = self.pose_products(candidate.components)
        functions = scanned_functions(self.linear, candidate, values)
        H, f = functions.size
        c = b.shape[1]
        xr, xq = _by_column(functions, b[:, :, None])[:, :, 0], _by_column(functions, C)
        xx = functions.sums_of_products(A.reshape(-1, c * c)).reshape(H, f, f, c, c).transpose(0, 3, 1, 4, 2).reshape(H, c * f, c * f)
        return functions, xx - xq @ np.swapaxes(xq, 1, 2), xr


def _by_column(functions: ScannedFunctions, by_pose: np.ndarray) -> np.ndarray:
    """(H, k, a): products of a candidate's columns, each of its functions times each of its components, with others; by_pose (P, c, a):
    those of the components alone.
    """
    P, c, a = by_pose.shape
    H, f = functions.size
    return functions.sums(by_pose.reshape(P, c * a)).reshape(H, f, c, a).transpose(0, 2, 1, 3).reshape(H, c * f, a)
