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
from mbcacq.estimation.identifiability import correlated_pairs
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
    best = {(e.name, e.location): e for e in sorted(effects, key=lambda e: e.sigmas)}  # variant of each effect and location
    alike = list[Alike]()
    if remaining:
        rows = np.stack(list(remaining.values()))
        alike = correlated_pairs(list(remaining), _inner(rows, rows, len(problem.Q)), OPTIONS.indistinguishable)
    return Detectability(tuple(sorted(best.values(), key=lambda e: e.sigmas)), missing, tuple(alike))


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
    """``count`` values of the effect's hyper-parameter over its range, or None if it has none."""
    if candidate.hyper is None:
        return [None]
    values = candidate.hyper.values
    return [float(v) for v in values[np.unique(np.linspace(0, len(values) - 1, count).astype(int))]]
