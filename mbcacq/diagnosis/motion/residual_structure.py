"""Structure in the residual of a channel that the effects do not explain: is it noise, and if not, what does it depend on?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, stdtr

from mbcacq.diagnosis.effect_found import EffectFound, MismatchEntry, ResponseShape
from mbcacq.diagnosis.motion.fit import MotionFit
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals

FEWEST_BINS = 3  # a table of fewer has no shape


# How a residual depends on one covariate: share of its mean square, predicted on held-out data, its name, p-value, bins and their means.
Dependence = tuple[float, str, float, ResponseShape]


def unnamed_effect(where: tuple[str, ...], on: str, p_value: float, gain: float, channel: str, shape: ResponseShape | None) -> EffectFound:
    """What a channel shows without a name for it."""
    of = EffectFound(name=UNKNOWN, where=where, depends_on=on, parameters={}, p_value=p_value, held_out_gain=gain)
    return replace(of, channel=channel, shape=shape)


def residual_structure(
    fit: MotionFit, j: int, runs: tuple[MotionSignals, ...], weight: float
) -> tuple[MismatchEntry | None, EffectFound | None]:
    """The covariate that predicts most of the residual of joint j of the group, fitted on one part and tested on the other.

    (None, None) for noise; no effect where no covariate predicts enough. weight: the residual of this joint as a share of the whole
    mismatch of its group.
    """
    used = fit.used[j]
    residual = [r[u] for r, u in zip(fit.residual_after[j], used, strict=True)]
    mean_square, floor = float(np.mean(np.concatenate(residual) ** 2)), float(fit.floor[j])
    if mean_square < NUMBERS.residual_chi2_dof * floor**2:
        return None, None
    best = _strongest(_covariates(fit.group, runs, fit.group.joints[j]), used, residual)
    axis, channel = fit.group.axes[fit.group.joints[j]], fit.group.name
    if best is None or best[0] < NUMBERS.least_residual_share:
        segments = NUMBERS.residual_segments
        p_value = float(chdtrc(segments, segments * mean_square / floor**2))
        return MismatchEntry(axis, "time", weight, p_value, channel=channel), None
    share, covariate, p_value, shape = best
    effect = unnamed_effect((axis,), covariate, p_value, share * weight, channel, shape)
    return MismatchEntry(axis, covariate, share * weight, p_value, channel=channel), effect


def _strongest(covariates: dict[str, list[np.ndarray]], used: list[np.ndarray], residual: list[np.ndarray]) -> Dependence | None:
    """The dependence of the largest share, its p-value corrected for the number of covariates; None if none predicts anything."""
    best = None
    for name, values in covariates.items():
        found = _dependence(name, [v[u] for v, u in zip(values, used, strict=True)], residual, len(covariates))
        if found is not None and found[0] > (0.0 if best is None else best[0]):
            best = found
    return best


def _covariates(group: ChannelGroup, runs: tuple[MotionSignals, ...], joint: int) -> dict[str, list[np.ndarray]]:
    out = {f"q{tag}": [run.q[:, k] for run in runs] for k, tag in enumerate(group.tags)}
    out |= {f"qd{tag}": [run.qd[:, k] for run in runs] for k, tag in enumerate(group.tags)}
    out[f"qdd{group.tags[joint]}"] = [run.qdd[:, joint] for run in runs]
    torque = [run.torque[:, joint] for run in runs if run.torque is not None]
    if len(torque) == len(runs) and group.name != "tau":
        out[f"tau{group.tags[joint]}"] = torque
    return out


def _dependence(name: str, values: list[np.ndarray], residual: list[np.ndarray], covariates: int) -> Dependence | None:
    """A table over the covariate (quantile bins), fitted on each half of the data and tested on the other."""
    v, r = np.concatenate(values), np.concatenate(residual)
    half = _halves(values)
    edges = np.unique(np.quantile(v, np.linspace(0, 1, NUMBERS.residual_bins + 1)))
    number = len(edges) - 1
    if number < FEWEST_BINS:
        return None
    bins = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, number - 1)
    predicted = np.zeros_like(r)
    for test in (0, 1):
        train = half != test
        predicted[~train] = _means(bins[train], r[train], number)[bins[~train]]
    errors = (np.array_split(error, NUMBERS.residual_segments) for error in (r, r - predicted))
    before, after = (np.array([np.mean(segment**2) for segment in segments]) for segments in errors)
    share = 1.0 - float(((r - predicted) ** 2).sum() / (r**2).sum())
    p = min(improvement_p_value(before, after) * covariates, 1.0)
    centres = 0.5 * (edges[1:] + edges[:-1])
    return share, name, p, ResponseShape(tuple(centres.tolist()), tuple(_means(bins, r, number).tolist()))


def _halves(values: list[np.ndarray]) -> np.ndarray:
    """Number of the half, 0 or 1, of each sample: whole runs alternately, or quarters of the only one."""
    if len(values) == 1:
        return np.concatenate([np.arange(len(x)) * 4 // len(x) % 2 for x in values])
    return np.concatenate([np.full(len(x), k % 2) for k, x in enumerate(values)])


def _means(bins: np.ndarray, values: np.ndarray, number: int) -> np.ndarray:
    """(number,) mean value in each bin, zero in an empty one."""
    return np.bincount(bins, values, minlength=number) / np.maximum(np.bincount(bins, minlength=number), 1)


def improvement_p_value(before: np.ndarray, after: np.ndarray) -> float:
    """One-sided p-value that the squared error of blocks (B,) became smaller: paired t-test of its square root."""
    gain = np.sqrt(before) - np.sqrt(after)
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return float(stdtr(len(gain) - 1, -gain.mean() / max(spread, 1e-300)))
