"""The smooth model of what has no name: groups of functions at places, each group with a size of its own, found by the data.

Every group is a random effect u ~ N(0, size^2 diag(weight^2)); sizes by MacKay's fixed point of the marginal likelihood, so
groups that the data do not ask for vanish, and places without data stay near zero instead of being extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dtrtri

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.nonparametric import covariates
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context

OWN_ORDER, OTHER_ORDER = 45.0, 9.0
START_MM = 0.02
SMALLEST = 0.03  # of the instrument noise: a group that moves nothing is dropped


@dataclass(frozen=True)
class RandomEffect:
    """at, depends_on: for the report. columns: (M, R, k); weight: (k,) relative prior sigma, falling with the order."""

    at: str
    depends_on: str
    columns: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class RandomEffectsModel:
    """Groups with coefficients and prior sigmas (all concatenated), the size of each group; used: how many coefficients are determined."""

    groups: tuple[RandomEffect, ...]
    coefficients: np.ndarray
    sigma: np.ndarray
    sizes: np.ndarray
    used: float

    @property
    def columns(self) -> np.ndarray:
        return np.concatenate([g.columns for g in self.groups], axis=2)

    def without(self, at: str) -> RandomEffectsModel | None:
        """The groups that are not at a place."""
        chosen = [g for g, group in enumerate(self.groups) if group.at != at]
        if not chosen:
            return None
        parts = self.parts()
        index = np.concatenate([np.arange(parts[g].start, parts[g].stop) for g in chosen])
        groups = tuple(self.groups[g] for g in chosen)
        return RandomEffectsModel(groups, self.coefficients[index], self.sigma[index], self.sizes[chosen], self.used)

    def parts(self) -> list[slice]:
        ends = np.cumsum([0] + [len(g.weight) for g in self.groups])
        return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]


def waves(x: np.ndarray, highest: float, least: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Cosines over a little more than the range of an angle x (P,), up to ``highest`` per turn: (P, K), and weights (K,)."""
    span = max(float(np.ptp(x)) * 1.15, 1e-9)
    count = int(np.clip(highest * span / np.pi, least, 90))
    k = np.arange(1, count + 1)
    return np.cos(np.pi * (x - x.min())[:, None] / span * k), 1.0 / (1.0 + (k * np.pi / span / (highest / 4)) ** 2)


def everything(linear: LinearProblem, s: Context) -> list[RandomEffect]:
    """Groups for a recording with many poses: gear, bearing, elasticity, coupling and time at every joint."""
    obs, out = linear.obs, []

    def group(at, name, keys, F, weight):
        columns = np.concatenate([linear.unit(*key)[:, :, None] * F[obs.pose][:, None, :] for key in keys], axis=2)
        out.append(RandomEffect(at, name, columns, np.tile(weight, len(keys))))

    moving = [i for i in range(s.n) if np.ptp(obs.q[:, i]) > 0.02]
    for i in moving:
        group(f"A{i + 1}", f"q{i + 1}", [("joint", i, 0)], *waves(obs.q[:, i], OWN_ORDER))
        low, weight = waves(obs.q[:, i], OTHER_ORDER)
        for c in range(6):
            group(f"link{i + 1}" if i + 1 < s.n else "mount", f"q{i + 1}", [("frame", i + 1, c)], low, weight)
        for j in moving:
            if j != i:
                group(f"A{j + 1}", f"q{i + 1}", [("joint", j, 0)], low[:, :5], weight[:5])
    for i in range(s.n):
        moment = s.gravity_moment(i)
        scale = max(float(np.abs(moment).max()), 1e-9)
        at, name = "base" if i == 0 else f"link{i}", f"gravity_torque_{max(i + 1, 2)}"
        group(at, name, [("frame", i, 3 + c) for c in range(3)], moment / scale, np.ones(3))
    F, weight = waves(s.order.astype(float), np.inf, 6) if obs.time_s is None else waves(s.time, np.inf, 6)
    F, weight = F[:, :6], np.ones(6)
    group("base", "time" if obs.time_s is not None else "pose", [("frame", 0, c) for c in range(6)], F, weight)
    group("mount", "time" if obs.time_s is not None else "pose", [("frame", s.n, c) for c in range(3)], F, weight)
    for name, T in obs.temperatures.items():
        if np.ptp(T) > 0.2:
            for i in range(s.n + 1):
                at = "base" if i == 0 else "mount" if i == s.n else f"link{i}"
                group(at, name, [("frame", i, c) for c in range(6)], covariates.standard(T)[:, None], np.ones(1))
    return out


def fit(
    screen: CandidateScoring, groups: tuple[RandomEffect, ...] | list[RandomEffect], start: np.ndarray | None = None, rounds: int = 25
) -> RandomEffectsModel | None:
    """Sizes and coefficients of the groups beyond what the screen has projected out. start: (G,) sizes to begin with."""
    if not groups:
        return None
    unit = []
    for g in groups:  # make a unit size move the centres by about a millimetre, so that sizes compare
        typical = np.sqrt(np.mean(g.columns[screen.linear.keep, :3] ** 2) * g.columns.shape[2])
        unit.append(g.weight / max(float(typical), 1e-12))
    scale = np.concatenate(unit)
    X = np.concatenate([screen.whiten(g.columns) for g in groups], axis=1) * scale
    taken = screen.all_projected.T @ X
    S, b = X.T @ X - taken.T @ taken, X.T @ screen.r
    ends = np.cumsum([0] + [len(g.weight) for g in groups])
    parts = [slice(a, z) for a, z in zip(ends[:-1], ends[1:], strict=True)]
    size2 = np.full(len(groups), START_MM**2) if start is None else start**2
    smallest = (SMALLEST * float(np.mean(screen.noise.point))) ** 2
    alive = np.ones(len(groups), bool)
    for _ in range(rounds):
        index = (
            np.concatenate([np.arange(p.start, p.stop) for p, a in zip(parts, alive, strict=True) if a])
            if alive.any()
            else np.zeros(0, int)
        )
        if len(index) == 0:
            return None
        prior = np.concatenate([np.full(p.stop - p.start, v) for p, v, a in zip(parts, size2, alive, strict=True) if a])
        root = np.sqrt(prior)  # in units of their prior sigma the coefficients' normal matrix is never worse than the identity
        normal = S[np.ix_(index, index)] * np.outer(root, root)
        normal[np.diag_indices_from(normal)] += 1.0
        factor = cholesky(normal, lower=True, overwrite_a=True, check_finite=False)
        u = root * cho_solve((factor, True), root * b[index], check_finite=False)
        half, _ = dtrtri(factor, lower=1)
        variance = prior * np.einsum("ij,ij->j", half, half)
        before, at = size2.copy(), 0
        for g in np.flatnonzero(alive):
            k = parts[g].stop - parts[g].start
            mine = slice(at, at + k)
            at += k
            determined = k - np.sum(variance[mine]) / size2[g]
            size2[g] = np.clip(np.sum(u[mine] ** 2) / max(determined, 1e-3), 1e-12, 1e2) if determined > 1e-4 else 0.0
        alive &= size2 > smallest
        if np.all(np.abs(np.log(size2[alive] / before[alive])) < 0.1):
            break
    chosen = [g for g in range(len(groups)) if alive[g]]
    index = np.concatenate([np.arange(parts[g].start, parts[g].stop) for g in chosen]) if chosen else np.zeros(0, int)
    if len(index) == 0:
        return None
    prior = np.concatenate([np.full(parts[g].stop - parts[g].start, size2[g]) for g in chosen])
    root = np.sqrt(prior)
    mine = S[np.ix_(index, index)] * np.outer(root, root)
    normal = mine + np.eye(len(index))
    u = root * np.linalg.solve(normal, root * b[index])
    used = float(np.trace(np.linalg.solve(normal, mine)))
    return RandomEffectsModel(
        tuple(groups[g] for g in chosen), u * scale[index], np.sqrt(prior) * scale[index], np.sqrt(size2[chosen]), used
    )
