"""The verdict: from the fitted model and its cross-validation to what is reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound, MismatchEntry
from mbcacq.diagnosis.evidence.between_sets import pairs_not_separable
from mbcacq.diagnosis.evidence_verdict import averaged_over_sets, verdict_by_evidence, with_alternatives
from mbcacq.diagnosis.findings import OUT_OF_TIME, NotSeparable
from mbcacq.diagnosis.model_fit import Contributions, ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.between_recordings import between_recordings, with_common_values
from mbcacq.diagnosis.output.effects_table import classes, effects_by_contribution, mismatch_table, with_classes, with_significance
from mbcacq.diagnosis.output.evidence_summary import summarized
from mbcacq.diagnosis.output.exclusion_limits import exclusion_limits
from mbcacq.diagnosis.output.next_measurements import elsewhere, revealing, separating
from mbcacq.diagnosis.output.notes import not_carried_over, notes, of_effects, sum_of_shares
from mbcacq.diagnosis.output.orders import with_orders
from mbcacq.diagnosis.output.pictures import plot_data
from mbcacq.diagnosis.output.sufficient_poses import limited_effects, says_too_little
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Diagnosis, FitFigures, FitSummary, HeldOutFigures
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, Member
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.found_again import Repetitions, with_spread_between_parts
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore, training_score
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.in_words import effect_in_words, odds_in_words


@dataclass(frozen=True, kw_only=True)
class JudgedFit:
    """The reported results of a fit. before: score on the data fitted with geometry alone, which leaves residual (M, R). pairs: that are
    not separable, with their coefficients.
    """

    full: ModelFit
    validation: CrossValidation
    before: PredictiveScore
    residual: np.ndarray
    verdict: str
    mismatch: list[MismatchEntry]
    effects: list[EffectFound]
    not_separable: tuple[NotSeparable, ...]
    pairs: tuple[tuple[Sequence[Member], Sequence[Member]], ...]


NOTHING_REPEATED: Repetitions = {}


def judge(setup: DiagnosisProblem, full: ModelFit, validation: CrossValidation, again: Repetitions = NOTHING_REPEATED) -> JudgedFit:
    """What the evidence says of a fit; the held-out figures of ``validation``, and whether parts of the recording show each effect
    ``again``, are reported beside it.
    """
    before, residual = training_score(replace(full, model=NO_EFFECTS).without_random_effects().joint)
    contributions = Contributions(full)
    found = effects_by_contribution(full, contributions, validation, again)
    effects, mismatch = averaged_over_sets(full, with_alternatives(full, found)), mismatch_table(full, contributions, before)
    alike = pairs_not_separable(full.evidence)
    pairs = (tuple(side.part(lambda m: m.candidate.name != UNKNOWN).with_coefficients for side in sides) for _, *sides in alike)
    return JudgedFit(
        full=full,
        validation=validation,
        before=before,
        residual=residual,
        verdict=verdict_of(full),
        mismatch=mismatch,
        effects=effects,
        not_separable=tuple(pair for pair, *_ in alike),
        pairs=tuple((ours, theirs) for ours, theirs in pairs if ours and theirs),
    )


def conclude(setup: DiagnosisProblem, fit: JudgedFit) -> Diagnosis:
    """The diagnosis of a fit that was judged: scores, uncertainties, advice, limits of what was not found; without the
    effects that are kept."""
    full, validation, before = fit.full, fit.validation, fit.before
    after, residual_after = training_score(full.joint)
    there = elsewhere(setup.context)
    limited = limited_effects(setup, full, there)
    # That nothing was found says little where little could have been.
    too_little = says_too_little(limited, setup.linear.obs.n_poses) if fit.verdict == "none" else None
    verdict = fit.verdict if too_little is None else "cannot_tell"
    advice = separating(setup.context, fit.pairs) if too_little is None else revealing(setup.context, limited)
    reported = with_significance(fit.effects, setup, full)
    evidence = summarized(setup, full.evidence)
    recordings = between_recordings(full)
    reported = with_orders(full, with_spread_between_parts(with_common_values(reported, recordings)))
    effects, mismatch = with_classes(reported, fit.mismatch, classes(full.geometry_only.linear.obs, fit.not_separable))
    once = not_found_again(effects) if verdict == "explained" else []
    if verdict == "explained" and (once or all(e.trend for e in effects)):
        verdict = "cannot_tell"  # a name without a figure, or one that halves do not both give, explains nothing
    return Diagnosis(
        verdict=verdict,
        mismatch=tuple(mismatch),
        effects=tuple(effects),
        fit=FitSummary(
            train=FitFigures(*_figures(before, after)),
            held_out=held_out_figures(validation),
            repeatability_floor_mm=expected_rms(full, after.rms),
        ),
        geometry_alone=setup.geometry_alone,
        not_separable=fit.not_separable,
        advice=tuple(advice),
        dropped=setup.dropped,
        notes=(
            *not_carried_over(verdict, validation, effects),
            *sum_of_shares(mismatch, before, after),
            *notes(setup, full),
            *of_effects(setup, full, fit.effects),
            *([] if too_little is None else [too_little]),
            *undecided_evidence(full),
            *once,
            *evidence.untried,
        ),
        exclusion_limits=exclusion_limits(full, setup.candidates, there),
        between_recordings=recordings,
        evidence=evidence,
        plot_data=plot_data(setup, full, mismatch, fit.residual, residual_after),
    )


def held_out_figures(validation: CrossValidation) -> HeldOutFigures:
    """The figures of the centres that are not rejected, and of every centre where some are."""
    before, after = validation.before, validation.after
    figures = HeldOutFigures(*_figures(before, after), split=validation.split)
    if after.every <= after.count:
        return figures
    return replace(
        figures,
        centres=after.every,
        robust_centres=after.count,
        every_before_rms_mm=before.rms_of_every,
        every_after_rms_mm=after.rms_of_every,
    )


def not_found_again(effects: Sequence[EffectFound]) -> list[str]:
    """A sentence where halves of the recording do not both show what was found."""
    named = [f"{effect_in_words(e.name)} at {one.at}" for e in effects for one in e.found_again if not one.repeats]
    if not named:
        return []
    return [f"halves of the recording do not both show {', '.join(named)}: the recording is not explained by what one part of it shows"]


def undecided_evidence(full: ModelFit) -> list[str]:
    """A sentence where the evidence neither shows an effect nor is as weak as without one, or where time ran out."""
    if full.evidence.cut_short:
        return [OUT_OF_TIME]
    if not full.evidence.undecided or full.random:
        return []
    odds, needed = odds_in_words(float(np.exp(full.evidence.log_e_value))), f"{OPTIONS.least_e_value:.0f} : 1"
    return [f"all effects together have {odds} against none, and an effect is reported from {needed} on: measure more"]


def _figures(before: PredictiveScore, after: PredictiveScore) -> tuple[float, float, float, float]:
    return before.rms, after.rms, before.chi2_dof, after.chi2_dof


def expected_rms(full: ModelFit, fallback: float) -> float:
    """3D rms (mm) expected at one centre from the estimated noise alone; fallback: where no centre was kept."""
    linear, noise = full.geometry_only.linear, full.noise
    joint = np.sum((linear.joint_columns[:, :3] * noise.joint) ** 2, axis=(1, 2))
    return float(np.sqrt(np.mean(joint[linear.keep]) + np.sum(noise.point**2))) if linear.keep.any() else fallback


def verdict_of(full: ModelFit) -> str:
    """The verdict on the data of the fit."""
    return verdict_by_evidence(full, full.evidence)
