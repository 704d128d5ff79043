"""Which physical effects a plan could show, and which it cannot tell apart: every catalogued effect at its usual size, geometry refitted.

What matters is not how far an effect moves the balls, but what is left of that once geometry, hand-eye and stations have absorbed
all they can, against the noise of the scanner and of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.plan import LoadedPlan, PlannedPose, Transit

SEEN = 6.0  # standard deviations of its own uncertainty at which an effect of usual size is reliably found among many
ALIKE = 0.95
HYPER_TRIED = 7


@dataclass(frozen=True)
class EffectDetectability:
    """One effect at one place. sigmas: its usual size over its standard uncertainty. absorbed: share of its trace in the measured
    balls that geometry and stations take up. usual: the size that was assumed (coefficients)."""

    name: str
    where: str
    sigmas: float
    absorbed: float

    @property
    def seen(self) -> bool:
        return self.sigmas >= SEEN

    def to_dict(self) -> dict[str, Any]:
        return {"effect": self.name, "where": self.where, "sigmas": self.sigmas, "absorbed": self.absorbed, "seen": self.seen}


@dataclass(frozen=True)
class Detectability:
    """Effects by visibility, pairs (effect, effect, correlation) alike, and what no plan can show without further records: name -> why."""

    effects: tuple[EffectDetectability, ...]
    alike: tuple[tuple[str, str, float], ...]
    missing: dict[str, str]

    def to_dict(self) -> dict[str, Any]:
        return {
            "effects": [e.to_dict() for e in self.effects],
            "missing": self.missing,
            "alike": [{"a": a, "b": b, "correlation": c} for a, b, c in self.alike],
        }


def visibility(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit] | None = None, starts: Sequence[float] | None = None
) -> Detectability:
    """All poses take part, those of the verification too: a diagnosis uses them all."""
    from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
    from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
    from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
    from mbcacq.effects.catalogue import candidates
    from mbcacq.effects.context import Context

    observations = planned_observations(loaded, poses, transits, starts)
    linear = LinearProblem.of(observations, planned_state(loaded))
    noise = planned_noise(loaded, poses)
    screen = CandidateScoring.of(linear, NoiseEstimate(noise.point, noise.joint, noise.turn))
    found, missing = candidates(Context(observations, planned_state(loaded), linear.prediction))
    effects, left = [], {}
    for candidate in found:
        tried = [_trace(screen, candidate, h) for h in _hyper(candidate)]
        size, absorbed, row = sorted(tried, key=lambda t: t[0])[len(tried) // 2]
        where = "+".join(candidate.where)
        effects.append(EffectDetectability(candidate.name, where, size, absorbed))
        if size >= SEEN:
            left[f"{candidate.name}:{where}"] = row
    return Detectability(tuple(_best(effects)), _alike(left, len(screen.Q)), missing)


def _trace(screen, candidate, hyper: float | None) -> tuple[float, float, np.ndarray]:
    """Length (in standard deviations) of what is left of the effect at usual size, share absorbed, and the effect as one row (rows + z,)
    under the metric of :func:`_inner`.

    Of several coefficients the least visible one counts, the others being free."""
    X = screen.block(candidate, hyper) * candidate.typical
    row = np.concatenate([X, screen.Q.T @ X]).T
    information = _inner(row, row, len(X))
    weakest = float(np.sqrt(max(np.linalg.eigvalsh(information)[0], 0.0)))
    return weakest, 1.0 - float(np.trace(information) / max(np.sum(X * X), 1e-300)), row.sum(axis=0)


def _inner(a: np.ndarray, b: np.ndarray, rows: int) -> np.ndarray:
    """x'(I - QQ')y of rows (x, Q'x) and (y, Q'y): what is left once the geometry is refitted, its priors allowing."""
    return a[:, :rows] @ b[:, :rows].T - a[:, rows:] @ b[:, rows:].T


def _hyper(candidate) -> list[float | None]:
    if candidate.hyper is None:
        return [None]
    values = candidate.hyper.values
    return [float(v) for v in values[np.unique(np.linspace(0, len(values) - 1, HYPER_TRIED).astype(int))]]


def _best(effects: list[EffectDetectability]) -> list[EffectDetectability]:
    """The most visible variant of each effect and place, least visible first."""
    best: dict[tuple[str, str], EffectDetectability] = {}
    for effect in effects:
        key = (effect.name, effect.where)
        if key not in best or best[key].sigmas < effect.sigmas:
            best[key] = effect
    return sorted(best.values(), key=lambda e: e.sigmas)


def _alike(left: dict[str, np.ndarray], rows: int) -> tuple[tuple[str, str, float], ...]:
    if len(left) < 2:
        return ()
    names, stacked = list(left), np.stack(list(left.values()))
    gram = _inner(stacked, stacked, rows)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    correlation = gram / np.outer(size, size)
    i, j = np.nonzero(np.triu(np.abs(correlation) > ALIKE, 1))
    order = np.argsort(-np.abs(correlation[i, j]))
    return tuple((names[i[k]], names[j[k]], float(correlation[i[k], j[k]])) for k in order)
