"""Random effects: the model of what has no parametric effect, groups of functions at locations, each group with a size of its own.

Every group is a random effect u ~ N(0, size^2 diag(weight^2)). Sizes maximise the marginal likelihood by MacKay's fixed point (1992), so
groups that the data do not ask for vanish, and ranges without data stay near zero instead of being extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky

from mbcacq.diagnosis.nonparametric import covariates
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.projection import inverse_of_lower
from mbcacq.effects.context import Context
from mbcacq.estimation.linear_problem import LinearProblem


@dataclass(frozen=True)
class RandomEffect:
    """location, depends_on: for the report. columns: (M, R, k); weight: (k,) relative prior sigma, falling with the order."""

    location: str
    depends_on: str
    columns: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class RandomEffectsModel:
    """Groups with coefficients and prior sigmas (all concatenated), the size of each group. used: coefficients that the data determine."""

    groups: tuple[RandomEffect, ...]
    coefficients: np.ndarray
    sigma: np.ndarray
    sizes: np.ndarray
    used: float

    @property
    def columns(self) -> np.ndarray:
        return np.concatenate([g.columns for g in self.groups], axis=2)

    def without(self, location: str) -> RandomEffectsModel | None:
        """The groups that are not at a location; None where none is left."""
        chosen = [g for g, group in enumerate(self.groups) if group.location != location]
        if not chosen:
            return None
        index = joined([self.slices()[g] for g in chosen])
        groups = tuple(self.groups[g] for g in chosen)
        return RandomEffectsModel(groups, self.coefficients[index], self.sigma[index], self.sizes[chosen], self.used)

    def slices(self) -> list[slice]:
        """Which coefficients belong to which group."""
        return slices_of(self.groups)


def slices_of(groups: Sequence[RandomEffect]) -> list[slice]:
    ends = np.cumsum([0] + [len(g.weight) for g in groups])
    return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]


def joined(slices: Sequence[slice]) -> np.ndarray:
    """Indices of some slices, one after the other."""
    return np.concatenate([np.arange(p.start, p.stop) for p in slices]) if slices else np.zeros(0, int)


def cosine_basis(x: np.ndarray, highest: float, least: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Cosines over a little more than the range of an angle x (P,), up to ``highest`` per turn: (P, K), and weights (K,)."""
    span = max(float(np.ptp(x)) * 1.15, 1e-9)
    count = int(np.clip(highest * span / np.pi, least, 90))
    k = np.arange(1, count + 1)
    return np.cos(np.pi * (x - x.min())[:, None] / span * k), 1.0 / (1.0 + (k * np.pi / span / (highest / 4)) ** 2)


def all_locations(linear: LinearProblem, s: Context) -> list[RandomEffect]:
    """Groups for a recording with many poses: gear, bearing, elasticity, coupling and time at every joint."""
    obs, out = linear.obs, list[RandomEffect]()

    def group(location: str, name: str, keys: list[tuple[str, int, int]], F: np.ndarray, weight: np.ndarray) -> None:
        columns = np.concatenate([linear.unit(*key)[:, :, None] * F[obs.pose][:, None, :] for key in keys], axis=2)
        out.append(RandomEffect(location, name, columns, np.tile(weight, len(keys))))

    moving = [i for i in range(s.n) if np.ptp(obs.q[:, i]) > 0.02]
    for i in moving:
        group(f"A{i + 1}", f"q{i + 1}", [("joint", i, 0)], *cosine_basis(obs.q[:, i], OPTIONS.own_order))
        low, weight = cosine_basis(obs.q[:, i], OPTIONS.other_order)
        for c in range(6):
            group(f"link{i + 1}" if i + 1 < s.n else "mount", f"q{i + 1}", [("frame", i + 1, c)], low, weight)
        for j in moving:
            if j != i:
                group(f"A{j + 1}", f"q{i + 1}", [("joint", j, 0)], low[:, :5], weight[:5])
    for i in range(s.n):
        moment = s.gravity_moment(i)
        scale = max(float(np.abs(moment).max()), 1e-9)
        location, name = "base" if i == 0 else f"link{i}", f"gravity_torque_{max(i + 1, 2)}"
        group(location, name, [("frame", i, 3 + c) for c in range(3)], moment / scale, np.ones(3))
    F, weight = cosine_basis(s.order.astype(float), np.inf, 6) if obs.time_s is None else cosine_basis(s.time, np.inf, 6)
    F, weight = F[:, :6], np.ones(6)
    group("base", "time" if obs.time_s is not None else "pose", [("frame", 0, c) for c in range(6)], F, weight)
    group("mount", "time" if obs.time_s is not None else "pose", [("frame", s.n, c) for c in range(3)], F, weight)
    for name, T in obs.temperatures.items():
        if np.ptp(T) > 0.2:
            for i in range(s.n + 1):
                location = "base" if i == 0 else "mount" if i == s.n else f"link{i}"
                group(location, name, [("frame", i, c) for c in range(6)], covariates.standard(T)[:, None], np.ones(1))
    return out


def fit_random_effects(
    projected: CandidateScoring, groups: Sequence[RandomEffect], start: np.ndarray | None = None, rounds: int = 25
) -> RandomEffectsModel | None:
    """Sizes and coefficients of the groups beyond what is projected out; None where the data ask for none. start: (G,) initial sizes."""
    if not groups:
        return None
    scale = np.concatenate([unit_weight(projected, g) for g in groups])
    X = np.concatenate([projected.whiten(g.columns) for g in groups], axis=1) * scale
    absorbed = projected.all_projected.T @ X
    S, b = X.T @ X - absorbed.T @ absorbed, X.T @ projected.r
    variance = np.full(len(groups), OPTIONS.initial_size_mm**2) if start is None else start**2
    smallest = (OPTIONS.smallest_size * float(np.mean(projected.noise.point))) ** 2
    slices = slices_of(groups)
    variance, alive = mackay_fixed_point(S, b, slices, variance, smallest, rounds)
    chosen = [int(g) for g in np.flatnonzero(alive)]
    if not chosen:
        return None
    index = joined([slices[g] for g in chosen])
    prior = prior_variance(slices, variance, chosen)
    root = np.sqrt(prior)
    information = S[np.ix_(index, index)] * np.outer(root, root)
    normal = information + np.eye(len(index))
    u = root * np.linalg.solve(normal, root * b[index])
    used = float(np.trace(np.linalg.solve(normal, information)))
    return RandomEffectsModel(
        tuple(groups[g] for g in chosen), u * scale[index], np.sqrt(prior) * scale[index], np.sqrt(variance[chosen]), used
    )


def unit_weight(projected: CandidateScoring, group: RandomEffect) -> np.ndarray:
    """(k,) weights with which a group of unit size moves the centres by about a millimetre, so that sizes compare."""
    typical = np.sqrt(np.mean(group.columns[projected.linear.keep, :3] ** 2) * group.columns.shape[2])
    return group.weight / max(float(typical), 1e-12)


def prior_variance(slices: list[slice], variance: np.ndarray, chosen: Sequence[int]) -> np.ndarray:
    """Prior variance of every coefficient of the chosen groups."""
    return np.concatenate([np.full(slices[g].stop - slices[g].start, variance[g]) for g in chosen])


def mackay_fixed_point(
    S: np.ndarray, b: np.ndarray, slices: list[slice], variance: np.ndarray, smallest: float, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Variance of each group (G,), and (G,) bool of those that stay above the smallest. S (k, k), b (k,): normal equations."""
    alive = np.ones(len(slices), bool)
    for _ in range(rounds):
        chosen = [int(g) for g in np.flatnonzero(alive)]
        if not chosen:
            break
        index, prior = joined([slices[g] for g in chosen]), prior_variance(slices, variance, chosen)
        root = np.sqrt(prior)  # in units of their prior sigma the coefficients' normal matrix is never worse than the identity
        normal = S[np.ix_(index, index)] * np.outer(root, root)
        normal[np.diag_indices_from(normal)] += 1.0
        factor = cholesky(normal, lower=True, overwrite_a=True, check_finite=False)
        u = root * cho_solve((factor, True), root * b[index], check_finite=False)
        half = inverse_of_lower(factor)
        posterior = prior * np.einsum("ij,ij->j", half, half)
        before, first = variance.copy(), 0
        for g in chosen:
            k = slices[g].stop - slices[g].start
            own = slice(first, first + k)
            first += k
            determined = k - np.sum(posterior[own]) / variance[g]
            variance[g] = np.clip(np.sum(u[own] ** 2) / max(determined, 1e-3), 1e-12, 1e2) if determined > 1e-4 else 0.0
        alive &= variance > smallest
        if np.all(np.abs(np.log(variance[alive] / before[alive])) < 0.1):
            break
    return variance, alive
