"""Exclusion limits: the size of every effect at every location above which it would have shown, with 95 % confidence.

A limit is of one parameter (an amplitude, a shift, a compliance) over a band of the effect's hyper-parameter (``limit_bands``). 95 % of all
effects of that size, with a value from the band and any direction of the coefficients, would have shown more than this recording does
(``upper_limit``).

Everything that the effect is confused with is free as well: geometry, what was found, the elasticity that every arm has, and the other
effects at its location. A slow error of a gear and the elasticity of its joint may compensate each other, and a limit of one that takes
the other for zero is false.

Sizes have a prior of what machines have. A limit beyond it says nothing: the effect was not tested by these poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.effect_found import NOT_SIZES
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.compensation import Compensation, largest
from mbcacq.diagnosis.output.next_measurements import Elsewhere, errors_of, harmless
from mbcacq.diagnosis.output.sufficient_poses import ABSORBED, of_fewest_coefficients
from mbcacq.diagnosis.output.upper_limit import LimitBand, alike, bands, directions, independent_values, kept, largest_ratio, upper_limit
from mbcacq.diagnosis.result import ExclusionBand, ExclusionLimit
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue, over_time
from mbcacq.effects.context import Context
from mbcacq.effects.effect import MOMENT, Candidate


@dataclass(frozen=True, kw_only=True)
class BandLimit:
    """The limit of one parameter over a band. effect: as large as that, at the value and in the direction that are determined least."""

    effect: Member
    band: LimitBand
    parameter: str
    value: float
    in_usual_sizes: float


def limits_of(problem: CandidateScoring, candidates: Sequence[Candidate], found: Sequence[Member]) -> list[BandLimit]:
    """Limits of every candidate that was not found, by band and parameter. problem: conditioned on what was found; candidates: of each
    effect at a location the variants of fewest coefficients.
    """
    there, out = {m.candidate.location for m in found}, list[BandLimit]()
    others = [c for c in candidates if c.location not in there]
    for c in candidates:
        if c.location not in there or (c.periodic and c.several):
            orders = [m.hyper for m in found if m.candidate.location == c.location and m.hyper is not None]
            out += limits_of_bands(with_confounders(problem, c, others), c, bands(c, orders))
    return out


def with_confounders(problem: CandidateScoring, candidate: Candidate, others: Sequence[Candidate]) -> CandidateScoring:
    """The problem with everything free that an effect is confused with: other effects at its location, and what every arm has."""
    beside = confounders(candidate, others)
    key = tuple((other.key, value) for other, value in beside)
    blocks = ((problem.block(other, value), largest(other) ** -2.0) for other, value in beside)
    return problem.known_beside.last("confounders", key, lambda: problem.conditioned_on(list(blocks)))


def confounders(candidate: Candidate, others: Sequence[Candidate]) -> list[tuple[Candidate, float | None]]:
    """The effects that are free beside one, each at values of its hyper-parameter."""
    out = []
    of_every_arm = {name for name in {other.name for other in others} if catalogue.declaration(name).every_arm}
    for other in others:
        here = other.name != candidate.name and not set(candidate.where).isdisjoint(other.where)
        if (here or other.name in of_every_arm) and other.key != candidate.key:
            out += [(other, value) for value in values_beside(other)]
    return out


def values_beside(other: Candidate) -> tuple[float | None, ...]:
    """Values of the hyper-parameter of an effect that is free beside another one: for a gear these are the slow orders, which are like much
    else."""
    hyper = other.hyper
    if hyper is None:
        return (None,)
    if hyper.kind == MOMENT:
        return ()
    return (1.0, 2.0) if other.periodic else (float(np.sort(hyper.values)[len(hyper.values) // 2]),)


class BandScan:
    """An effect at all values of its bands, scanned at once, in typical sizes.

    Normal matrices (H, k, k) and right-hand sides (H, k) are beyond what the problem is conditioned on.
    """

    def __init__(self, problem: CandidateScoring, candidate: Candidate, own: Sequence[LimitBand]):
        self.problem, self.candidate, t = problem, candidate, candidate.typical
        self.values = tuple(sorted({value for band in own for value in band.values if value is not None})) or (None,)
        S, b = problem.normal_matrices(candidate, self.values)
        self._information, self._gradient = S * np.outer(t, t), b * t

    def at(self, band: LimitBand) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices and right-hand sides at the values of a band."""
        some = self._places(band)
        return self._information[some], self._gradient[some]

    def _places(self, band: LimitBand) -> list[int]:
        place = {value: j for j, value in enumerate(self.values)}
        return [place[value] for value in band.values]

    @cached_property
    def _noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices (H, k, k) with geometry alone, and right-hand sides (H, k, draws) of recordings of noise."""
        S, b = self.problem.scores_of_noise(self.candidate, self.values)
        t = self.candidate.typical
        return S * np.outer(t, t), b * t[:, None]

    def independent(self, band: LimitBand, parameter: str, which: np.ndarray) -> float:
        """Number of independent values of a band, for a parameter of some coefficients (indices): by recordings of noise alone.

        The geometry absorbs the effect at none of these values; at others of the scan it may.
        """
        if len(band.values) == 1:
            return 1.0

        def by_noise() -> float:
            information, scores = (each[self._places(band)] for each in self._noise)
            covariance = np.linalg.inv(information)
            drawn, own = (covariance @ scores)[:, which], covariance[:, which][:, :, which]
            positive = self.candidate.positive and self.candidate.k == 1
            return independent_values(largest_ratio(drawn, own, positive), len(which), positive)

        return self.problem.known(("independent", self.candidate.key, band.values, parameter), by_noise)


def limits_of_bands(problem: CandidateScoring, candidate: Candidate, own: Sequence[LimitBand]) -> list[BandLimit]:
    """Limits of a candidate over its bands; everything that the problem is conditioned on is free."""
    if not own:
        return []
    scan = BandScan(problem, candidate, own)
    return [limit for band in own for limit in limits_of_band(scan, band)]


def limits_of_band(scan: BandScan, band: LimitBand) -> list[BandLimit]:
    """One limit for each parameter that is a size."""
    candidate, (information, gradient) = scan.candidate, scan.at(band)
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
    positive = candidate.positive and candidate.k == 1
    out = []
    for name, (which, unit) in parameters.items():
        c, V = estimate[:, which] * unit, covariance[:, which][:, :, which] * np.outer(unit, unit)
        along = directions(len(which))
        precision = np.einsum("dk,hkl,dl->hd", along, np.linalg.inv(V), along)
        number = scan.independent(own, name, which)
        size = upper_limit(float(largest_ratio(c, V, positive)), precision, number, len(which), positive)
        h, d = np.unravel_index(int(precision.argmin()), precision.shape)
        coefficients = np.zeros(candidate.k)
        coefficients[which] = size * along[d] / unit * candidate.typical[which]
        effect = Member(candidate, own.values[h], coefficients=coefficients)
        out.append(BandLimit(effect=effect, band=own, parameter=name, value=size, in_usual_sizes=float(size / np.max(unit))))
    return out


def absorbed(candidate: Candidate, band: LimitBand, parameter: str) -> BandLimit:
    """No limit: the geometry absorbs the effect at every value of the band."""
    effect = Member(candidate, band.values[0], coefficients=np.full(candidate.k, np.inf))
    return BandLimit(effect=effect, band=band, parameter=parameter, value=np.inf, in_usual_sizes=np.inf)


def parameters_of(candidate: Candidate, hyper: float | None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name of each parameter that is a size -> the coefficients (indices) of which it is the length, and by how much a typical size of each
    changes it. A coefficient that shows in several parameters counts for the first.
    """
    nothing = np.zeros((candidate.k, candidate.k))
    own: dict[str, list[tuple[int, float]]] = {}
    for j in range(candidate.k):
        reported = candidate.parameters(candidate.typical * (np.arange(candidate.k) == j), nothing, hyper)
        sizes = {n: float(np.linalg.norm(np.atleast_1d(p.value))) for n, p in reported.items() if n.rpartition(".")[2] not in NOT_SIZES}
        name = next((n for n, size in sizes.items() if size > 0), None)
        if name is not None:
            own.setdefault(name, []).append((j, sizes[name]))
    return {name: (np.array([j for j, _ in each]), np.array([size for _, size in each])) for name, each in own.items()}


def exclusion_limits(full: ModelFit, candidates: Sequence[Candidate], there: Elsewhere) -> tuple[ExclusionLimit, ...]:
    """The limits as they are reported: those that these poses test come first, then those with the largest error in the workspace, and each
    reading but once.

    An effect that the geometry absorbs and no length shows is not listed, nor is a change in time that the places of the stations absorb:
    it acts on nothing that will be measured.
    """
    problem, effects, few = conditioned_on_everything(full), full.model.members, of_fewest_coefficients(candidates)
    linear = full.geometry_only.linear
    context = Context(linear.obs, there.context.state, linear.prediction)
    compensation = Compensation.of(full.geometry_only, there)
    found = {m.candidate.location for m in effects}
    others = [c for c in few if c.location not in found]
    out: dict[tuple, ExclusionLimit] = {}
    for limit in limits_of(problem, few, effects):
        gone, candidate = not np.isfinite(limit.value), limit.effect.candidate
        if gone and (catalogue.declaration(candidate.name).acts_in_time or harmless(there, limit.effect)):
            continue
        tested = limit.in_usual_sizes <= OPTIONS.largest_usual
        moved = compensation.displacement(limit.effect, confounders(candidate, others)) if tested else None
        workspace_mm, length_mm = errors_of(there, moved)
        one = ExclusionLimit(
            name=candidate.name,
            where=candidate.where,
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
    hyper, band = limit.effect.candidate.hyper, limit.band
    if hyper is None:
        return None
    values = np.array(band.values, dtype=float)
    ends = [float(values.min()), float(values.max())]
    left_out = list(band.left_out)
    if hyper.kind == MOMENT:
        ends, left_out = ([float(over_time.pose_at(context, v)) for v in some] for some in (ends, left_out))
    return ExclusionBand(hyper.name, ends[0], ends[1], tuple(left_out))


def conditioned_on_everything(full: ModelFit) -> CandidateScoring:
    """The projected problem beside the effects that were found and, of a short recording, the unmodelled ones."""
    if full.estimated is None:
        return full.conditioned
    linear = full.conditioned.linear
    return full.conditioned.conditioned_on([(full.conditioned.whiten(linear.columns(g.parts)), g.sigma**-2.0) for g in full.random])
