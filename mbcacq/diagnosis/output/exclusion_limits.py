"""Exclusion limits: the largest size of every effect at every location that a recording does not exclude, with 95 % confidence.

A coefficient c is estimated as c^ with standard deviation s, and |c| is below |c^| + 1.645 s in 95 % of recordings, whatever it is. An
effect of known sign is below c^ + 1.645 s, where an estimate below -s counts as -s, so that noise never excludes what the recording could
not show (power-constrained limits: Cowan, Cranmer, Gross, Vitells 2011, arXiv:1105.3166). The limit of a parameter of several
coefficients, an amplitude or a shift, is the largest such limit over all directions.

With the effect everything is free that it is confused with: geometry, what was found, the elasticity that every arm has, and the other
effects at its location. A slow error of a gear and the elasticity of its joint may compensate each other, and a limit of one that takes
the other for zero is false. The limit is the largest over the values of the hyper-parameter that it names (``limit_bands``).

Sizes have a prior of what machines have. A limit beyond it says nothing: the effect was not tested by these poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.errors_elsewhere import errors_elsewhere, harmless
from mbcacq.diagnosis.output.limit_bands import LimitBand, alike, bands, kept
from mbcacq.diagnosis.output.next_measurements import Elsewhere, SizedEffect
from mbcacq.diagnosis.output.sufficient_poses import QUANTILE, of_fewest_coefficients
from mbcacq.diagnosis.result import ExclusionBand, ExclusionLimit
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects import catalogue, steps
from mbcacq.effects.context import Context
from mbcacq.effects.effect import MOMENT, Candidate
from mbcacq.effects.trend import NOT_SIZES

ABSORBED = 1e-6  # information on a typical size below which the geometry absorbs the effect
ASCENTS = 12  # towards the direction of the largest limit; each is nearer by far more than half


@dataclass(frozen=True, kw_only=True)
class BandLimit:
    """The limit of one parameter over a band. coefficients (k,): as large as the limit, where it is largest; inf where the geometry absorbs
    them.
    """

    candidate: Candidate
    band: LimitBand
    parameter: str
    value: float
    hyper: float | None
    coefficients: np.ndarray
    in_usual_sizes: float

    @property
    def sized(self) -> SizedEffect:
        """The effect as large as the limit."""
        return SizedEffect(self.candidate, self.hyper, self.coefficients)


def limits_of(
    problem: CandidateScoring, candidates: Sequence[Candidate], found: Sequence[tuple[Candidate, float | None]]
) -> list[BandLimit]:
    """Limits of every candidate that was not found, by band and parameter. problem: conditioned on what was found."""
    few = of_fewest_coefficients(candidates)
    there = {(c.name, c.where) for c, _ in found}
    out = []
    for candidate in few:
        orders = [h for c, h in found if (c.name, c.where) == (candidate.name, candidate.where) and h is not None]
        if (candidate.name, candidate.where) in there and not (candidate.periodic and candidate.several):
            continue
        beside = with_confounders(problem, candidate, [c for c in few if (c.name, c.where) not in there])
        for band in bands(candidate, orders):
            out += limits_of_band(beside, candidate, band)
    return out


def with_confounders(problem: CandidateScoring, candidate: Candidate, others: Sequence[Candidate]) -> CandidateScoring:
    """The problem with everything free that an effect is confused with: other effects at its location, and what every arm has."""
    blocks, sigma = [], []
    for other in others:
        here = set(other.where) & set(candidate.where) and other.name != candidate.name
        if other.key == candidate.key or not (here or catalogue.declaration(other.name).every_arm):
            continue
        for value in values_beside(other):
            blocks.append(problem.block(other, value))
            sigma.append(OPTIONS.largest_usual * other.typical)
    if not blocks:
        return problem
    return problem.conditioned_on([(np.concatenate(blocks, axis=1), np.concatenate(sigma) ** -2.0)])


def values_beside(other: Candidate) -> tuple[float | None, ...]:
    """Values of the hyper-parameter of an effect that is free beside another one: of a gear the slow orders, which are like much else."""
    hyper = other.hyper
    if hyper is None:
        return (None,)
    if hyper.kind == MOMENT:
        return ()
    return (1.0, 2.0) if other.periodic else (float(np.sort(hyper.values)[len(hyper.values) // 2]),)


def limits_of_band(problem: CandidateScoring, candidate: Candidate, band: LimitBand) -> list[BandLimit]:
    """One limit for each parameter that is a size."""
    information, gradient = in_typical_sizes(problem, candidate, band)
    value, vectors = np.linalg.eigh(information)
    std = 1.0 / np.sqrt(np.maximum(value[:, 0], ABSORBED))
    chosen = alike(candidate, band, std) & (value[:, 0] > ABSORBED)
    parameters = parameters_of(candidate, band.values[0])
    if not chosen.any():
        return [absorbed(candidate, band, name) for name in parameters]
    own = kept(band, chosen)
    root = vectors[chosen] / np.sqrt(value[chosen])[:, None, :]
    covariance = root @ np.swapaxes(root, 1, 2)
    estimate = (covariance @ gradient[chosen][:, :, None])[:, :, 0]
    out = []
    for name, (which, unit) in parameters.items():
        c, V = estimate[:, which] * unit, covariance[:, which][:, :, which] * np.outer(unit, unit)
        sizes, direction = largest_size(c, V, candidate.positive and candidate.k == 1)
        h = int(sizes.argmax())
        coefficients = np.zeros(candidate.k)
        coefficients[which] = sizes[h] * direction[h] / unit * candidate.typical[which]
        usual = float(sizes[h] / np.max(unit))
        out.append(
            BandLimit(
                candidate=candidate,
                band=own,
                parameter=name,
                value=float(sizes[h]),
                hyper=own.values[h],
                coefficients=coefficients,
                in_usual_sizes=usual,
            )
        )
    return out


def absorbed(candidate: Candidate, band: LimitBand, parameter: str) -> BandLimit:
    """No limit: the geometry absorbs the effect at every value of the band."""
    return BandLimit(
        candidate=candidate,
        band=band,
        parameter=parameter,
        value=np.inf,
        hyper=band.values[0],
        coefficients=np.full(candidate.k, np.inf),
        in_usual_sizes=np.inf,
    )


def in_typical_sizes(problem: CandidateScoring, candidate: Candidate, band: LimitBand) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices (H, k, k) and right-hand sides (H, k) of coefficients in typical sizes, beyond what the problem is conditioned on."""
    t = candidate.typical
    if candidate.components:
        S, b = problem.normal_matrices(candidate, np.array(band.values, dtype=float))
        return S * np.outer(t, t), b * t
    S, b = [], []
    for value in band.values:
        X, own, along = problem.candidate_products(candidate, value)
        absorbed_part = problem.conditioned.T @ X
        S.append((own - absorbed_part.T @ absorbed_part) * np.outer(t, t))
        b.append((along - absorbed_part.T @ problem.along) * t)
    return np.array(S), np.array(b)


def parameters_of(candidate: Candidate, hyper: float | None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name of each parameter that is a size -> the coefficients (indices) of which it is the length, and by how much a typical size of each
    changes it. A coefficient that shows in several parameters counts for the first.
    """
    nothing = np.zeros((candidate.k, candidate.k))
    own: dict[str, list[tuple[int, float]]] = {}
    for j in range(candidate.k):
        reported = candidate.report(candidate.typical * (np.arange(candidate.k) == j), nothing, hyper)
        sizes = {n: float(np.linalg.norm(np.atleast_1d(p.value))) for n, p in reported.items() if n.rpartition(".")[2] not in NOT_SIZES}
        name = next((n for n, size in sizes.items() if size > 0), None)
        if name is not None:
            own.setdefault(name, []).append((j, sizes[name]))
    return {name: (np.array([j for j, _ in each]), np.array([size for _, size in each])) for name, each in own.items()}


def largest_size(c: np.ndarray, V: np.ndarray, positive: bool) -> tuple[np.ndarray, np.ndarray]:
    """(H,) the largest limit over all directions of vectors with estimates c (H, k) and covariances V (H, k, k), and that direction (H, k).

    The limit is a convex function of the direction: following its gradient it only rises.
    """
    if c.shape[1] == 1:
        std = np.sqrt(V[:, 0, 0])
        return (np.maximum(c[:, 0], -std) if positive else np.abs(c[:, 0])) + QUANTILE * std, np.ones_like(c)
    sizes, directions = np.full(len(c), -np.inf), np.zeros_like(c)
    for start in (np.linalg.eigh(V)[1][:, :, -1], c / np.maximum(np.linalg.norm(c, axis=1, keepdims=True), 1e-300)):
        v = start
        for _ in range(ASCENTS):
            sign = np.where(np.einsum("hk,hk->h", v, c) < 0, -1.0, 1.0)[:, None]
            along = np.einsum("hkl,hl->hk", V, v)
            slope = sign * c + QUANTILE * along / np.sqrt(np.maximum(np.einsum("hk,hk->h", v, along), 1e-300))[:, None]
            v = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300)
        reached = np.abs(np.einsum("hk,hk->h", v, c)) + QUANTILE * np.sqrt(np.einsum("hk,hkl,hl->h", v, V, v))
        better = reached > sizes
        sizes, directions = np.where(better, reached, sizes), np.where(better[:, None], v, directions)
    return sizes, directions


def exclusion_limits(full: ModelFit, candidates: Sequence[Candidate], there: Elsewhere) -> tuple[ExclusionLimit, ...]:
    """As they are reported: those that these poses test first, of these the ones with the largest error in the workspace, and each reading
    but once.

    What the geometry absorbs and no length shows is not listed, nor a change in time that the places of the stations absorb: it acts on
    nothing that will be measured.
    """
    context = Context(full.geometry_only.linear.obs, there.context.state, full.geometry_only.linear.prediction)
    out: dict[tuple, ExclusionLimit] = {}
    for limit in limits_of(conditioned_on_everything(full), candidates, full.model.effects):
        gone = not np.isfinite(limit.value)
        if gone and (catalogue.declaration(limit.candidate.name).acts_in_time or harmless(there, limit.sized)):
            continue
        tested = limit.in_usual_sizes <= OPTIONS.largest_usual
        workspace_mm, length_mm = errors_elsewhere(there, limit.sized) if tested else (None, None)
        one = ExclusionLimit(
            name=limit.candidate.name,
            where=limit.candidate.where,
            parameter=limit.parameter,
            value=None if gone else limit.value,
            workspace_mm=workspace_mm,
            length_mm=length_mm,
            in_usual_sizes=None if gone else limit.in_usual_sizes,
            tested=tested,
            holds_for=holds_for(context, limit),
        )
        out.setdefault((one.name, one.where, one.parameter, one.holds_for), one)
    return tuple(sorted(out.values(), key=lambda e: (not e.tested, -(e.workspace_mm or 0.0), e.in_usual_sizes or np.inf)))


def holds_for(context: Context, limit: BandLimit) -> ExclusionBand | None:
    """The band of a limit as it is reported: moments by the numbers of their poses."""
    hyper, band = limit.candidate.hyper, limit.band
    if hyper is None:
        return None
    values = np.array(band.values, dtype=float)
    ends = [float(values.min()), float(values.max())]
    left_out = list(band.left_out)
    if hyper.kind == MOMENT:
        ends, left_out = ([float(steps.pose_at(context, v)) for v in some] for some in (ends, left_out))
    return ExclusionBand(hyper.name, ends[0], ends[1], tuple(left_out))


def conditioned_on_everything(full: ModelFit) -> CandidateScoring:
    """The projected problem beside the effects that were found and, of a short recording, the unmodelled ones."""
    if full.estimated is None:
        return full.conditioned
    linear = full.conditioned.linear
    return full.conditioned.conditioned_on([(full.conditioned.whiten(linear.columns(g.parts)), g.sigma**-2.0) for g in full.random])
