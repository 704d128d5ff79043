"""Which physical effects a plan could show, and which it cannot tell apart: every catalogued effect at its usual size, geometry refitted.

The measure is not how far an effect moves the balls. It is the part of that motion that geometry, hand-eye and stations cannot absorb,
against the noise of the scanner and of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from mbcacq.design.options import OPTIONS
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.catalogue import candidates
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.model.json_text import AsJson, keyed
from mbcacq.plan import LoadedPlan, PlannedPose, Transit

Alike = Annotated[tuple[str, str, float], keyed("a", "b", "correlation")]


@dataclass(frozen=True)
class EffectDetectability(AsJson):
    """Detectability of one effect at one location.

    sigmas: its usual size over its standard uncertainty. absorbed: share of its trace in the measured balls that geometry and stations
    take up. detectable: it would reliably be found among many.
    """

    name: Annotated[str, Field(alias="effect")]
    location: Annotated[str, Field(alias="where")]
    sigmas: float
    absorbed: float
    detectable: Annotated[bool, Field(alias="seen")]


@dataclass(frozen=True)
class Detectability(AsJson):
    """Detectability of the catalogued effects, least detectable first.

    indistinguishable: pairs (effect, effect, correlation). missing: effects that no plan can show without further records, name -> why.
    """

    effects: tuple[EffectDetectability, ...]
    missing: dict[str, str]
    indistinguishable: Annotated[tuple[Alike, ...], Field(alias="alike")]


def detectability(
    loaded: LoadedPlan,
    poses: Sequence[PlannedPose],
    transits: Sequence[Transit] | None = None,
    starts: Sequence[float] | np.ndarray | None = None,
) -> Detectability:
    """Detectability by all poses, those of the verification too: a diagnosis uses them all. starts: (P,) s, for effects of time."""
    observations = planned_observations(loaded, poses, transits, starts)
    linear = LinearProblem.of(observations, planned_state(loaded))
    noise = planned_noise(loaded, poses)
    problem = CandidateScoring.of(linear, Noise(noise.point, noise.joint, noise.turn))
    found, missing = candidates(Context(observations, planned_state(loaded), linear.prediction))
    effects, remaining = [], {}
    for candidate in found:
        tried = [_projected(problem, candidate, h) for h in hyper_values(candidate, OPTIONS.hyperparameters_tried)]
        sigmas, absorbed, row = sorted(tried, key=lambda t: t[0])[len(tried) // 2]
        location = "+".join(candidate.where)
        detectable = sigmas >= OPTIONS.detectable_sigmas
        effects.append(EffectDetectability(candidate.name, location, sigmas, absorbed, detectable))
        if detectable:
            remaining[f"{candidate.name}:{location}"] = row
    return Detectability(tuple(_best(effects)), missing, _indistinguishable(remaining, len(problem.Q), OPTIONS.indistinguishable))


def _projected(problem: CandidateScoring, candidate: Candidate, hyper: float | None) -> tuple[float, float, np.ndarray]:
    """An effect at its usual size with the geometry refitted: what remains (in standard deviations), the share absorbed, and the effect as
    one row (rows + z,) under the metric of ``_inner``.

    The least visible of several coefficients counts, the others being free.
    """
    X = problem.block(candidate, hyper) * candidate.typical
    row = np.concatenate([X, problem.Q.T @ X]).T
    information = _inner(row, row, len(X))
    weakest = float(np.sqrt(max(np.linalg.eigvalsh(information)[0], 0.0)))
    return weakest, 1.0 - float(np.trace(information) / max(np.sum(X * X), 1e-300)), row.sum(axis=0)


def _inner(a: np.ndarray, b: np.ndarray, rows: int) -> np.ndarray:
    """x'(I - QQ')y of rows (x, Q'x) and (y, Q'y): what remains once the geometry is refitted, its priors allowing."""
    return a[:, :rows] @ b[:, :rows].T - a[:, rows:] @ b[:, rows:].T


def hyper_values(candidate: Candidate, count: int) -> list[float | None]:
    """``count`` values of the effect's hyper-parameter over its range, or None where it has none."""
    if candidate.hyper is None:
        return [None]
    values = candidate.hyper.values
    return [float(v) for v in values[np.unique(np.linspace(0, len(values) - 1, count).astype(int))]]


def _best(effects: list[EffectDetectability]) -> list[EffectDetectability]:
    """The most detectable variant of each effect and location, least detectable first."""
    best: dict[tuple[str, str], EffectDetectability] = {}
    for effect in effects:
        key = (effect.name, effect.location)
        if key not in best or best[key].sigmas < effect.sigmas:
            best[key] = effect
    return sorted(best.values(), key=lambda e: e.sigmas)


def _indistinguishable(remaining: dict[str, np.ndarray], rows: int, limit: float) -> tuple[tuple[str, str, float], ...]:
    """Pairs of effects whose rows correlate by more than ``limit``, most alike first."""
    if len(remaining) < 2:
        return ()
    names, stacked = list(remaining), np.stack(list(remaining.values()))
    gram = _inner(stacked, stacked, rows)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    correlation = gram / np.outer(size, size)
    i, j = np.nonzero(np.triu(np.abs(correlation) > limit, 1))
    order = np.argsort(-np.abs(correlation[i, j]))
    return tuple((names[i[k]], names[j[k]], float(correlation[i[k], j[k]])) for k in order)
