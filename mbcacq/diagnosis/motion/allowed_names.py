"""Names that physics does not allow for what a motion shows: it is reported as an unmodelled effect at its joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.effect_found import ResponseShape
from mbcacq.diagnosis.motion.fit import FittedEffect, MotionFit
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.catalogue import declaration
from mbcacq.effects.motion_effect import MotionSignals
from mbcacq.effects.support import joints_without_drive
from mbcacq.quantities import K

LEAST_SHARE = 0.05  # of the power that friction takes in all, which it may seem to give at some speeds: less is the error of its parts


def refused_name(fit: MotionFit, effect: FittedEffect, runs: Sequence[MotionSignals]) -> str:
    """Why an effect of a motion cannot be what it is called, as the end of a sentence; empty if it can."""
    candidate, declared = effect.candidate, declaration(effect.candidate.name)
    robot = runs[0].robot
    if robot is not None and (without := joints_without_drive(candidate, robot)):
        return f"{without}, and {declared.without_drive}"
    parameters = effect.found.parameters
    values, stds = next(iter(parameters.values())).components if parameters else ((0.0,), (0.0,))
    if candidate.positive and values[0] < -K * stds[0]:
        return "it cannot be negative"
    if not declared.dissipative:
        return ""
    joint = candidate.rows.joints[0]
    speed, lost = _of_joint(fit, effect, [run.qd[:, joint] for run in runs])
    each = [float(np.mean(part)) for part in np.array_split((speed * lost)[np.argsort(np.abs(speed))], NUMBERS.residual_bins)]
    return "friction takes energy at every speed, and this gives some" if min(each) < -LEAST_SHARE * sum(map(abs, each)) else ""


def response_shape(fit: MotionFit, effect: FittedEffect, runs: Sequence[MotionSignals]) -> tuple[str, ResponseShape]:
    """What an effect adds to the mismatch of its joint, over that joint's speed where it loses torque, and over its angle elsewhere."""
    joint = effect.candidate.rows.joints[0]
    motor_side = declaration(effect.candidate.name).motor_side
    of = [(run.qd if motor_side else run.q)[:, joint] for run in runs]
    x, y = _of_joint(fit, effect, of)
    parts = np.array_split(np.argsort(x), NUMBERS.residual_bins)
    shape = ResponseShape(tuple(float(x[p].mean()) for p in parts), tuple(float(y[p].mean()) for p in parts))
    return f"{'qd' if motor_side else 'q'}{joint + 1}", shape


def refused_in_words(fits: Sequence[MotionFit], runs: Sequence[MotionSignals]) -> list[str]:
    """A sentence on each name that was refused."""
    out = []
    for fit in fits:
        for effect in fit.effects:
            if why := refused_name(fit, effect, runs):
                at = "+".join(effect.candidate.where)
                out.append(f"{effect.candidate.name} at {at} fits and is refused as a name: {why}; it is reported as an unmodelled effect")
    return out


def _of_joint(fit: MotionFit, effect: FittedEffect, values: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Values of a covariate and what the effect adds to the mismatch, at the samples that count."""
    j = fit.group.index(effect.candidate.rows.joints[0])
    used = fit.used[j]
    x = np.concatenate([v[u] for v, u in zip(values, used, strict=True)])
    return x, np.concatenate([c[u] for c, u in zip(effect.contributions[j], used, strict=True)])
