"""The diagnosis of motion put together from the fits of all groups of channels."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.fit import FitStep, FittedEffect, MotionFit
from mbcacq.diagnosis.motion.options import MotionOptions
from mbcacq.diagnosis.motion.residual_structure import residual_structure
from mbcacq.diagnosis.motion.result import (
    ChannelFit,
    ErrorBeforeAfter,
    MotionAlternative,
    MotionDiagnosis,
    MotionEffect,
    MotionMismatch,
    MotionStep,
    UnmodelledMotionEffect,
)
from mbcacq.effects.motion.effect import MotionSignals

BETWEEN_JOINTS = "wrist_coupling"  # acts from one joint on another


def assemble(
    fits: list[MotionFit], runs: tuple[MotionSignals, ...], cross_validated: dict[str, np.ndarray] | None, options: MotionOptions
) -> MotionDiagnosis:
    """cross_validated: mean squares (2, J) before and after by group, on parts that took no part in selecting or fitting; None for the
    figures by which effects were selected."""
    effects: list[MotionEffect | UnmodelledMotionEffect] = []
    mismatch: list[MotionMismatch] = []
    channels: list[ChannelFit] = []
    for fit in fits:
        held_out = np.stack([fit.held_out_before, fit.held_out_after]) if cross_validated is None else cross_validated[fit.group.name]
        excess = _excess(fit)
        effects += [_effect(fit, e, excess) for e in fit.effects]
        mismatch += [_mismatch(fit, e, excess) for e in fit.effects]
        for j in range(len(fit.group.joints)):
            channels.append(_channel(fit, j, held_out[:, j]))
            weight = max(float(fit.held_out_after[j]) / fit.floor[j] ** 2 - 1.0, 0.0) / excess
            dependence, unmodelled = residual_structure(fit, j, runs, min(weight, 1.0), options)
            mismatch += [] if dependence is None else [dependence]
            effects += [] if unmodelled is None else [unmodelled]
    return MotionDiagnosis(
        _verdict(effects, channels, options),
        tuple(sorted(mismatch, key=lambda m: -m.share)),
        tuple(sorted(effects, key=lambda e: -e.held_out_gain)),
        tuple(channels),
        fits[0].split,
    )


def _verdict(effects: list[MotionEffect | UnmodelledMotionEffect], channels: list[ChannelFit], options: MotionOptions) -> str:
    named = any(isinstance(e, MotionEffect) for e in effects)
    unexplained = any(c.held_out.after_chi2_dof > options.unexplained_chi2_dof for c in channels)
    if named:
        return "partly_explained" if unexplained else "explained"
    return "unexplained" if any(c.held_out.before_chi2_dof > options.unexplained_chi2_dof for c in channels) else "none"


def _excess(fit: MotionFit) -> float:
    """Held-out chi2 over the noise, of all joints of a group before any effect."""
    return max(float(np.maximum(fit.held_out_before / fit.floor**2 - 1.0, 0.0).sum()), 1e-300)


def _effect(fit: MotionFit, effect: FittedEffect, excess: float) -> MotionEffect:
    at = [fit.group.index(joint) for joint in effect.joints]
    own_excess = float(np.maximum(fit.held_out_before[at] / fit.floor[at] ** 2 - 1.0, 0.0).sum())
    drop = float((effect.gain / fit.floor**2).sum())
    return MotionEffect(
        effect.name,
        effect.where,
        effect.depends_on,
        fit.group.name,
        effect.parameters,
        effect.p_value,
        drop / max(excess, 1e-300),
        float((effect.gain[at] / fit.floor[at] ** 2).sum()) / max(own_excess, 1e-300),
        tuple(MotionAlternative(a.name, a.where, a.gain * drop / max(excess, 1e-300)) for a in effect.alternatives),
        tuple(_step(fit, step, at) for step in effect.steps),
    )


def _step(fit: MotionFit, step: FitStep, at: list[int]) -> MotionStep:
    scale = _scale(fit)
    before, after = ({_axis(fit, j): scale * float(np.sqrt(square[j])) for j in at} for square in (step.before, step.after))
    return MotionStep(tuple(step.adds), before, after)


def _mismatch(fit: MotionFit, effect: FittedEffect, excess: float) -> MotionMismatch:
    at = effect.where[0] if len(effect.joints) == 1 and effect.name != BETWEEN_JOINTS else effect.where[-1]
    share = float((effect.gain / fit.floor**2).sum()) / excess
    return MotionMismatch(at, fit.group.name, effect.depends_on, share, effect.p_value)


def _channel(fit: MotionFit, j: int, held_out: np.ndarray) -> ChannelFit:
    scale, floor = _scale(fit), float(fit.floor[j])

    def error(before: float, after: float) -> ErrorBeforeAfter:
        rms = scale * float(np.sqrt(before)), scale * float(np.sqrt(after))
        return ErrorBeforeAfter(*rms, float(before / floor**2), float(after / floor**2))

    unit = "deg" if fit.group.unit == "rad" else fit.group.unit
    train = error(fit.train_before[j], fit.train_after[j])
    return ChannelFit(fit.group.name, _axis(fit, j), unit, scale * floor, train, error(held_out[0], held_out[1]))


def _axis(fit: MotionFit, j: int) -> str:
    return f"A{fit.group.joints[j] + 1}"


def _scale(fit: MotionFit) -> float:
    """From the unit of the computation to that of the result."""
    return float(np.degrees(1)) if fit.group.unit == "rad" else 1.0
