"""Is an effect determined by the data?

A value at the end of what was tried is no estimate, one within its uncertainty of zero no finding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel, SelectedEffect
from mbcacq.effects.motion_effect import Parameters

BOUND = 1e-6  # relative distance from the first or last value tried within which a hyper-parameter is at that bound
NOT_A_SIZE = ("order", "phase_deg", "zero_deg")  # parameters that say where an effect is, not how large


@dataclass(frozen=True)
class UndeterminedEffect:
    """An effect that the data ask for without determining its parameters. correlation: of its estimate with that of ``other``, the effect
    that resembles it most ('arm' stands for the masses of the links)."""

    name: str
    where: tuple[str, ...]
    other: str
    correlation: float


def at_bound(effect: SelectedEffect) -> bool:
    """The reported hyper-parameter is at the first or last value that was tried."""
    candidate, hyper = effect.candidate, effect.variant.hyper
    if not candidate.hyper_parameter or candidate.hyper is None or hyper is None:
        return False
    first, last = float(np.min(candidate.hyper)), float(np.max(candidate.hyper))
    return hyper >= last * (1.0 - BOUND) or (not candidate.no_lower_bound and hyper <= first * (1.0 + BOUND))


def significance(parameters: Parameters, hyper_parameter: str) -> float:
    """Largest absolute value of a size over its standard deviation."""
    ratios = [0.0]
    for name, entry in parameters.items():
        if name != hyper_parameter and not name.endswith(NOT_A_SIZE):
            value, std = np.atleast_1d(entry["value"]), np.atleast_1d(entry["std"])
            ratios.append(float(np.max(np.abs(value) / np.maximum(std, 1e-300))))
    return max(ratios)


def least_determined(model: MotionModel, x: np.ndarray, spread: np.ndarray) -> SelectedEffect | None:
    """The selected effect whose size is least certain, if that is below the options' ``determined_sigmas``; effects that others refine
    come after those. x: coefficients of ``chosen()``; spread: covariance of them and of the hyper-parameters."""
    position = {int(c): i for i, c in enumerate(model.chosen())}
    refined = {e.candidate.location for e in model.selected if e.candidate.extends}
    found: list[tuple[float, SelectedEffect]] = []
    for effect in model.selected:
        candidate = effect.candidate
        if candidate.location in refined and not candidate.extends:
            continue
        at = [position[int(i)] for i in effect.variant.ids]
        parameters = candidate.report(x[at], spread[np.ix_(at, at)], effect.variant.hyper, 0.0)
        found.append((significance(parameters, candidate.hyper_parameter), effect))
    if not found:
        return None
    least, effect = min(found, key=lambda pair: pair[0])
    return effect if least < model.options.determined_sigmas else None


def resemblance(model: MotionModel, effect: SelectedEffect, spread: np.ndarray) -> tuple[str, float]:
    """The name of the effect, or 'arm', whose coefficients are most correlated with those of this one, and the canonical correlation."""
    position = {int(c): i for i, c in enumerate(model.chosen())}
    own = [position[int(i)] for i in effect.variant.ids][: effect.candidate.tested]
    others = {
        f"{e.candidate.name}:{'+'.join(e.candidate.where)}": [position[int(i)] for i in e.variant.ids]
        for e in model.selected
        if e.candidate.location != effect.candidate.location and set(e.candidate.joints) & set(effect.candidate.joints)
    }
    if model.group.base[0].shape[2]:
        n = model.runs[0].q.shape[1]
        others["arm"] = [position[int(i)] for i in model.store.base[len(model.group.joints) : -n]]
    strongest = {name: canonical_correlation(spread, own, at) for name, at in others.items()}
    return max(strongest.items(), key=lambda pair: pair[1]) if strongest else ("", 0.0)


def canonical_correlation(spread: np.ndarray, own: list[int], other: list[int]) -> float:
    """Largest canonical correlation between two sets of coefficients with covariance ``spread``."""
    one, two = (_whitener(spread[np.ix_(at, at)]) for at in (own, other))
    return float(np.clip(np.linalg.svd(one @ spread[np.ix_(own, other)] @ two.T, compute_uv=False)[0], 0.0, 1.0))


def _whitener(v: np.ndarray) -> np.ndarray:
    d = 1.0 / np.sqrt(np.maximum(np.diag(v), 1e-300))
    values, vectors = np.linalg.eigh(v * np.outer(d, d))
    good = values > 1e-8
    return (vectors[:, good] / np.sqrt(values[good])).T * d
