"""The diagnosis of motion put together from the fits of all groups of channels.

The held-out table of channels decides. A joint of a channel that its model makes worse there keeps no model, and the effects of a joint
share the improvement that the table states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound, MismatchEntry
from mbcacq.diagnosis.evidence.between_sets import pairs_not_separable
from mbcacq.diagnosis.findings import Advice, NotSeparable
from mbcacq.diagnosis.motion.allowed_names import refused_name, response_shape
from mbcacq.diagnosis.motion.fit import FittedEffect, MotionFit
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.residual_structure import residual_structure, unnamed_effect
from mbcacq.diagnosis.motion.result import (
    BodyInertia,
    ChannelEvidence,
    ChannelFit,
    CheckedChannel,
    ErrorBeforeAfter,
    FitOfMotion,
    MotionDiagnosis,
)
from mbcacq.diagnosis.output.evidence_summary import summary_of
from mbcacq.effects import catalogue
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.motion_effect import MotionSignals
from mbcacq.quantities import in_degrees

MILLI = 1e3  # mm in a metre


@dataclass(frozen=True)
class HeldOutTable:
    """Held-out mean squares (J,) of one group before and after; refused: (J,) where the model made it worse; gains: (J,) by effect."""

    fit: MotionFit
    before: np.ndarray
    after: np.ndarray
    refused: np.ndarray
    gains: list[np.ndarray]

    @classmethod
    def of(cls, fit: MotionFit, cross_validated: np.ndarray | None) -> HeldOutTable:
        """cross_validated: (2, J) mean squares, None for those by which effects were selected."""
        before, after = (fit.held_out_before, fit.held_out_after) if cross_validated is None else cross_validated
        refused = np.asarray(after > before)
        removed = np.where(refused, 0.0, before - after)
        drops = [np.where(np.isin(fit.group.joints, e.candidate.rows.joints), np.maximum(e.gain, 0.0), 0.0) for e in fit.effects]
        total = np.maximum(sum(drops, np.zeros(len(before))), 1e-300)
        return cls(fit, before, np.where(refused, before, after), refused, [removed * drop / total for drop in drops])

    @property
    def excess(self) -> float:
        """Held-out chi2 over the noise, of all joints of the group before any effect."""
        return max(float(np.maximum(self.before / self.fit.floor**2 - 1.0, 0.0).sum()), 1e-300)

    def share(self, gain: np.ndarray, at: list[int] | None = None) -> float:
        """Share of the excess of these joints (all if None) that a gain (J,) removes."""
        where = list(range(len(self.before))) if at is None else at
        own = float(np.maximum(self.before[where] / self.fit.floor[where] ** 2 - 1.0, 0.0).sum())
        return float((gain[where] / self.fit.floor[where] ** 2).sum()) / max(own, 1e-300)

    def keeps(self, effect: FittedEffect) -> bool:
        """Some joint on which the effect acts keeps its model."""
        return not all(self.refused[self.fit.group.index(joint)] for joint in effect.candidate.rows.joints)


def assemble(fits: list[MotionFit], runs: tuple[MotionSignals, ...], cross_validated: dict[str, np.ndarray] | None) -> MotionDiagnosis:
    """cross_validated: mean squares (2, J) before and after by group, on held-out parts, not used in selecting or fitting; None for the
    figures by which effects were selected."""
    effects: list[EffectFound] = []
    mismatch: list[MismatchEntry] = []
    channels: list[ChannelFit] = []
    refused = False
    for fit in fits:
        table = HeldOutTable.of(fit, None if cross_validated is None else cross_validated[fit.group.name])
        refused_after = table.after if cross_validated is None else cross_validated[fit.group.name][1]
        for effect, gain in zip(fit.effects, table.gains, strict=True):
            if table.keeps(effect):
                if refused_name(fit, effect, runs):
                    refused = True
                    effects.append(_unmodelled(table, effect, gain, runs))
                else:
                    effects.append(_effect(table, effect, gain))
                mismatch.append(_mismatch(table, effect, gain))
        for j in range(len(fit.group.joints)):
            channels.append(_channel(table, j, float(refused_after[j])))
            weight = max(float(table.after[j]) / fit.floor[j] ** 2 - 1.0, 0.0) / table.excess
            dependence, unmodelled = residual_structure(fit, j, runs, min(weight, 1.0))
            mismatch += [] if dependence is None else [dependence]
            effects += [] if unmodelled is None else [unmodelled]
    loads = tuple(pair for fit in fits for pair in fit.load_alternatives)
    alike = tuple(pair for fit in fits if fit.sets is not None for pair, *_ in pairs_not_separable(fit.sets))
    not_separable = (*alike, *loads)
    return MotionDiagnosis(
        verdict="cannot_tell" if not_separable or cut_short(fits) else _verdict(fits, effects, channels, refused),
        mismatch=tuple(sorted(mismatch, key=lambda m: -m.share)),
        effects=tuple(sorted(effects, key=lambda e: -e.held_out_gain)),
        fit=FitOfMotion.of(channels, fits[0].split),
        not_separable=not_separable,
        advice=(*_advice_on_sets(alike), *_advice(runs, loads)),
        inertial=tuple(b for fit in fits for b in _inertial(fit)),
        evidence=tuple(ChannelEvidence(fit.group.name, summary_of(fit.sets)) for fit in fits if fit.sets is not None),
    )


def cut_short(fits: list[MotionFit]) -> bool:
    """Whether time ran out before all sets of effects were compared."""
    return any(fit.sets is not None and fit.sets.cut_short for fit in fits)


def _verdict(fits: list[MotionFit], effects: list[EffectFound], channels: list[ChannelFit], refused: bool) -> str:
    """As that of poses: ``cannot_tell`` where the evidence neither shows an effect nor is as weak as without one; a residual above the
    noise is unexplained, and so is what fits under a name that was refused.
    """
    named = any(e.name != UNKNOWN for e in effects)
    unexplained = refused or any(c.held_out.after_chi2_dof > NUMBERS.unexplained_chi2_dof for c in channels)
    if not named and not unexplained and any(fit.sets is not None and fit.sets.undecided for fit in fits):
        return "cannot_tell"
    if named:
        return "partly_explained" if unexplained else "explained"
    return "unexplained" if unexplained else "none"


def _effect(table: HeldOutTable, effect: FittedEffect, gain: np.ndarray) -> EffectFound:
    at = [table.fit.group.index(joint) for joint in effect.candidate.rows.joints]
    return replace(effect.found, held_out_gain=table.share(gain), held_out_gain_here=table.share(gain, at))


def _unmodelled(table: HeldOutTable, effect: FittedEffect, gain: np.ndarray, runs: tuple[MotionSignals, ...]) -> EffectFound:
    """An effect whose name was refused."""
    on, shape = response_shape(table.fit, effect, runs)
    where, p_value, channel = effect.candidate.where[-1:], effect.found.p_value, table.fit.group.name
    return unnamed_effect(where, on, p_value, table.share(gain), channel, shape)


def _mismatch(table: HeldOutTable, effect: FittedEffect, gain: np.ndarray) -> MismatchEntry:
    c = effect.candidate
    at = c.where[0] if len(c.rows.joints) == 1 and not catalogue.declaration(c.name).between_locations else c.where[-1]
    return MismatchEntry(at, c.depends_on, table.share(gain), effect.found.p_value, channel=table.fit.group.name)


def _channel(table: HeldOutTable, j: int, refused_after: float) -> ChannelFit:
    fit, scale = table.fit, table.fit.group.scale
    train, held_out = _error(fit, j, fit.train_before[j], fit.train_after[j]), _error(fit, j, table.before[j], table.after[j])
    refused = scale * float(np.sqrt(refused_after)) if table.refused[j] else None
    return ChannelFit(fit.group.name, _axis(fit, j), fit.group.shown_unit, scale * float(fit.floor[j]), train, held_out, refused)


def checked_channels(fit: MotionFit, before: np.ndarray, after: np.ndarray) -> list[CheckedChannel]:
    """Residuals of a fit in another recording, joint by joint; before, after: mean squares (J,) without and with its effects."""
    each = ((_axis(fit, j), _error(fit, j, before[j], after[j])) for j in range(len(fit.group.joints)))
    return [CheckedChannel(fit.group.name, at, fit.group.shown_unit, error) for at, error in each]


def _error(fit: MotionFit, j: int, before: float, after: float) -> ErrorBeforeAfter:
    """before, after: mean squares of joint j."""
    scale, floor = fit.group.scale, float(fit.floor[j])
    rms = scale * float(np.sqrt(before)), scale * float(np.sqrt(after))
    return ErrorBeforeAfter(*rms, float(before / floor**2), float(after / floor**2))


def _advice_on_sets(pairs: tuple[NotSeparable, ...]) -> list[Advice]:
    """Advice on recordings, if the evidence does not exclude another set."""
    if not pairs:
        return []
    names = "; ".join(" and ".join(pair.effects) for pair in pairs)
    further = "record a further motion with other speeds, more reversals and a wider range"
    return [Advice(f"{names} explain these recordings equally well: {further}", ())]


def _advice(runs: tuple[MotionSignals, ...], not_separable: tuple[NotSeparable, ...]) -> list[Advice]:
    """The axes that should move further, if effects could not be told apart. Gravity torques of the masses, of a tool and of a balancer go
    together over a small range of angles, and apart over a large one."""
    robot = runs[0].robot
    if not not_separable or robot is None:
        return []
    low, high = (in_degrees(f([f(run.q, axis=0) for run in runs], axis=0)) for f in (np.min, np.max))
    limits = in_degrees(robot.limits)
    small = [j for j in range(1, robot.n) if high[j] - low[j] < NUMBERS.wide_range * (limits[j, 1] - limits[j, 0])]
    ranges = ", ".join(f"{robot.axes[j]} {low[j]:.0f} to {high[j]:.0f} of {limits[j, 0]:.0f} to {limits[j, 1]:.0f}" for j in small)
    names = "; ".join(" and ".join(n.effects) for n in not_separable)
    reason = (
        f"{names} are confounded over the angles recorded (in °: {ranges or 'all wide'}): record a motion over as much of these ranges as "
        "the cell allows (mbcacq plan design PLAN --motion RECORDING makes one), and the same motion once with a known weight on the flange"
    )
    return [Advice(reason, ())]


def _inertial(fit: MotionFit) -> list[BodyInertia]:
    if fit.inertial is None:
        return []
    tools = any(catalogue.declaration(e.candidate.name).adds_body for e in fit.effects)
    links = len(fit.inertial) - tools
    return [
        BodyInertia(f"link{k + 1}" if k < links else "tool", float(p[0]), tuple((MILLI * p[1:4]).tolist()), tuple(p[4:].tolist()))
        for k, p in enumerate(fit.inertial)
    ]


def _axis(fit: MotionFit, j: int) -> str:
    return fit.group.axes[fit.group.joints[j]]
