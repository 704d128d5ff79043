"""The part of an effect that is common to several recordings of one arm, and the part that differs from day to day.

Every effect is fitted to each recording by itself, with the geometry of all. The values are a random effect with a common value and a
variance between recordings, by restricted maximum likelihood (as in meta-analysis: Hardy, Thompson 1996).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.problem import EACH_RECORDING
from mbcacq.diagnosis.search.bayes_factor import prior_weight
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate, ParameterEstimate
from mbcacq.estimation.several_recordings import BetweenRecordings


def between_recordings(full: ModelFit) -> tuple[BetweenRecordings, ...]:
    """One entry for each parameter of each effect; none of a single recording."""
    obs = full.geometry_only.linear.obs
    shared = [m for m in full.model.members if m.candidate.hyper is None or m.candidate.hyper.name != "at_pose"]
    if obs.recording is None or not shared:
        return ()
    out = []
    for candidate, values, std in values_of_recordings(full, shared):
        for name, value in values.items():
            if np.all(std[name] > 0):
                out.append(BetweenRecordings.of(candidate.name, candidate.where, name, value, std[name]))
    return tuple(out)


def with_common_values(effects: Sequence[EffectFound], each: Sequence[BetweenRecordings]) -> list[EffectFound]:
    """The effects. Parameters that differ between the recordings have the common value, with an uncertainty that covers their differences:
    a fit to all recordings is more certain of its value than another day allows.
    """
    differing: dict[tuple[str, str], list[BetweenRecordings]] = {}
    for one in each:
        differing.setdefault((one.name, one.parameter), []).append(one)
    out = []
    for effect in effects:
        common = {
            key: ParameterEstimate(found[0].common, found[0].common_std)
            for key, stated in effect.parameters.items()
            if not isinstance(stated.value, tuple)  # several lines of a gear, or a value for each recording
            and len(found := differing.get((effect.name, key), [])) == 1
            and found[0].differs
        }
        out.append(replace(effect, parameters={**effect.parameters, **common}))
    return out


def values_of_recordings(full: ModelFit, effects: Sequence[Member]) -> list[tuple[Candidate, dict[str, np.ndarray], dict[str, np.ndarray]]]:
    """For each effect its parameters of one component, values (R,) and standard deviations (R,), all of them fitted together."""
    projected = full.geometry_only
    obs = projected.linear.obs
    count = obs.n_recordings
    assert obs.recording is not None, "asked of several recordings only"
    of_row = np.repeat(obs.recording[obs.pose], projected.linear.width)
    blocks, weights = [], []
    for m in effects:
        X = projected.block(m.candidate, m.hyper)
        own = m.candidate.variant == EACH_RECORDING
        blocks += [X] if own else [np.where(of_row[:, None] == r, X, 0.0) for r in range(count)]
        weights += [prior_weight(m.candidate)] * (1 if own else count)
    X = np.concatenate(blocks, axis=1)
    absorbed = projected.Q.T @ X
    S = X.T @ X - absorbed.T @ absorbed + np.diag(np.concatenate(weights))
    size = np.sqrt(np.diag(S))
    covariance = np.linalg.inv(S / np.outer(size, size)) / np.outer(size, size)
    coefficients = covariance @ (X.T @ projected.beyond_geometry())
    out, first = [], 0
    for m in effects:
        candidate = m.candidate
        times = 1 if candidate.variant == EACH_RECORDING else count
        reports = []
        for _ in range(times):
            own = slice(first, first + candidate.k)
            first = own.stop
            reports.append(candidate.parameters(coefficients[own], covariance[own, own], m.hyper))
        single = [name for name, p in reports[0].items() if times == 1 or not isinstance(p.value, tuple)]
        values = {name: np.concatenate([np.atleast_1d(r[name].value) for r in reports]) for name in single}
        std = {name: np.concatenate([np.atleast_1d(r[name].std) for r in reports]) for name in single}
        out.append((candidate, values, std))
    return out
