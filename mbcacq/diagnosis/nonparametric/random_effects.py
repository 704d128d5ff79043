"""Random effects: the model of what has no parametric effect, groups of functions at locations, each group with a size of its own.

Every group is a random effect u ~ N(0, size^2 diag(weight^2)) whose size maximises the marginal likelihood: groups that the data do not
ask for vanish, and ranges without data stay near zero instead of being extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric import covariates
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.random_effect_sizes import joined, posterior_of, sizes_by_marginal_likelihood


@dataclass(frozen=True)
class RandomEffect:
    """location, depends_on: for the report. columns: (M, R, k); weight: (k,) relative prior sigma, falling with the order."""

    location: str
    depends_on: str
    columns: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class RandomEffectOfPose:
    """A random effect before its columns are computed, which take much memory: components at a location, (place, index, component) each,
    by functions (P, f) of the poses with weights (f,).
    """

    location: str
    depends_on: str
    components: tuple[tuple[str, int, int], ...]
    functions: np.ndarray
    weight: np.ndarray

    def on(self, linear: LinearProblem, poses: np.ndarray | None = None) -> RandomEffect:
        """Its columns at the poses of a linearisation, which are these (P,) bool of all."""
        F = (self.functions if poses is None else self.functions[poses])[linear.obs.pose][:, None, :]
        columns = np.concatenate([linear.unit(*component)[:, :, None] * F for component in self.components], axis=2)
        return RandomEffect(self.location, self.depends_on, columns, np.tile(self.weight, len(self.components)))


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


def cosine_basis(x: np.ndarray, highest: float, least: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Cosines over a little more than the range of an angle x (P,), up to ``highest`` per turn: (P, K), and weights (K,)."""
    span = max(float(np.ptp(x)) * 1.15, 1e-9)
    count = int(np.clip(highest * span / np.pi, least, 90))
    k = np.arange(1, count + 1)
    return np.cos(np.pi * (x - x.min())[:, None] / span * k), 1.0 / (1.0 + (k * np.pi / span / (highest / 4)) ** 2)


def all_locations(s: Context) -> list[RandomEffectOfPose]:
    """Groups for a recording with many poses: gear, bearing, elasticity, coupling and time at every joint."""
    obs, out = s.obs, list[RandomEffectOfPose]()

    def group(location: str, name: str, components: list[tuple[str, int, int]], F: np.ndarray, weight: np.ndarray) -> None:
        out.append(RandomEffectOfPose(location, name, tuple(components), F, weight))

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


@dataclass(frozen=True)
class _NormalEquations:
    """Of the groups' coefficients beyond what is projected out, in units of ``scale`` (k,)."""

    groups: tuple[RandomEffect, ...]
    scale: np.ndarray
    S: np.ndarray
    b: np.ndarray

    @classmethod
    def of(cls, projected: CandidateScoring, groups: Sequence[RandomEffect]) -> _NormalEquations:
        scale = np.concatenate([unit_weight(projected, g) for g in groups])
        X = np.concatenate([projected.whiten(g.columns) for g in groups], axis=1)
        X *= scale
        absorbed = projected.all_projected.T @ X
        return cls(tuple(groups), scale, X.T @ X - absorbed.T @ absorbed, X.T @ projected.r)

    def solved(self, sizes: np.ndarray) -> RandomEffectsModel | None:
        """The coefficients with these sizes (G,); None where all are zero."""
        chosen = [int(g) for g in np.flatnonzero(sizes > 0)]
        if not chosen:
            return None
        slices = slices_of(self.groups)
        index = joined([slices[g] for g in chosen])
        prior = np.concatenate([np.full(slices[g].stop - slices[g].start, sizes[g] ** 2) for g in chosen])
        mean, variance = posterior_of(self.S[np.ix_(index, index)], self.b[index], prior)
        used = float(np.sum(1.0 - variance / prior))
        scale = self.scale[index]
        return RandomEffectsModel(tuple(self.groups[g] for g in chosen), mean * scale, np.sqrt(prior) * scale, sizes[chosen], used)


def fit_random_effects(projected: CandidateScoring, groups: Sequence[RandomEffect], start: np.ndarray) -> RandomEffectsModel | None:
    """Sizes and coefficients of the groups beyond what is projected out; None where the data ask for none. start: (G,) initial sizes."""
    if not groups:
        return None
    system = _NormalEquations.of(projected, groups)
    smallest = OPTIONS.smallest_size * float(np.mean(projected.noise.point))
    limits = smallest, OPTIONS.largest_size_mm
    return system.solved(sizes_by_marginal_likelihood(system.S, system.b, slices_of(groups), start, limits, OPTIONS.size_rounds))


def solve_random_effects(projected: CandidateScoring, groups: Sequence[RandomEffect], sizes: np.ndarray) -> RandomEffectsModel | None:
    """Coefficients of groups of given sizes (G,)."""
    return _NormalEquations.of(projected, groups).solved(sizes) if groups else None


def unit_weight(projected: CandidateScoring, group: RandomEffect) -> np.ndarray:
    """(k,) weights with which a group of unit size moves the centres by about a millimetre, so that sizes compare."""
    typical = np.sqrt(np.mean(group.columns[projected.linear.keep, :3] ** 2) * group.columns.shape[2])
    return group.weight / max(float(typical), 1e-12)
