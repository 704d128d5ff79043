"""The verdict: from the fitted model and its cross-validation to what is reported.

One bound on false alarms holds at every size of recording; names and their alternatives have posterior odds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.effect_found import Alternative, EffectFound
from mbcacq.diagnosis.evidence.between_sets import BetweenSets, alternatives_to, better_in_general, pairs_not_separable
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import alternatives_of, reported_hypothesis
from mbcacq.diagnosis.findings import OUT_OF_TIME, NotSeparable
from mbcacq.diagnosis.model_fit import Contributions, ModelFit, joint_noise_factor
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.between_recordings import between_recordings, with_common_values
from mbcacq.diagnosis.output.effects_table import classes, effects_by_contribution, mismatch_table, with_classes, with_significance
from mbcacq.diagnosis.output.evidence_summary import summarized
from mbcacq.diagnosis.output.exclusion_limits import exclusion_limits
from mbcacq.diagnosis.output.next_measurements import elsewhere, revealing, separating
from mbcacq.diagnosis.output.notes import not_carried_over, notes, of_effects, rejected_balls, sum_of_shares
from mbcacq.diagnosis.output.orders import with_orders
from mbcacq.diagnosis.output.pictures import plot_data
from mbcacq.diagnosis.output.sufficient_poses import limited_effects, says_too_little
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Diagnosis, FitFigures, FitSummary, HeldOutFigures
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet, Member
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.found_again import Repetitions, with_spread_between_parts
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore, training_score
from mbcacq.effects.effect import label_of
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.quantities import K

NOTHING_REPEATED: Repetitions = {}


def conclude(setup: DiagnosisProblem, full: ModelFit, validation: CrossValidation, again: Repetitions = NOTHING_REPEATED) -> Diagnosis:
    """The diagnosis of a fit by its evidence: verdict, scores, uncertainties, alternatives, advice, limits of what was not found.

    The held-out figures of ``validation``, and whether parts of the recording show each effect ``again``, are reported beside it. The
    effects that are kept are not in it.
    """
    contributions = Contributions(full)
    before, residual = training_score(replace(full, model=NO_EFFECTS).without_random_effects().joint)
    after, residual_after = training_score(full.joint)
    found = averaged_over_sets(full, with_alternatives(full, effects_by_contribution(full, contributions, validation, again)))
    alike, verdict = pairs_not_separable(full.evidence, full.everywhere), verdict_of(full, found)
    there = elsewhere(setup.context)
    limited = limited_effects(setup, full, there)
    # That nothing was found says little where little could have been.
    too_little = says_too_little(limited, setup.linear.obs.n_poses) if verdict == "none" else None
    verdict = verdict if too_little is None else "cannot_tell"
    advice = separating(setup.context, named_alone(alike)) if too_little is None else revealing(setup.context, limited)
    reported = with_significance(found, setup, full)
    evidence = summarized(setup, full.evidence)
    recordings = between_recordings(full)
    reported = with_orders(full, with_spread_between_parts(with_common_values(reported, recordings)))
    not_separable = tuple(pair for pair, *_ in alike)
    mismatch = mismatch_table(full, contributions, before)
    effects, mismatch = with_classes(reported, mismatch, classes(full.geometry_only.linear.obs, not_separable))
    once = not_found_again(effects) if verdict == "explained" else []
    left_out = rejected_balls(full.geometry_only.linear.obs, full.geometry_only.linear.keep)
    if once or (left_out and verdict in ("none", "explained")) or (effects and all(e.trend for e in effects)):
        verdict = "cannot_tell"  # a name that parts do not give again, trends alone, or less than what was measured explain nothing
    said = [*not_carried_over(verdict, validation, effects), *sum_of_shares(mismatch, before, after), *notes(setup, full)]
    said += [*of_effects(setup, full, found), *([] if too_little is None else [too_little]), *undecided_evidence(full)]
    return Diagnosis(
        verdict=verdict,
        mismatch=tuple(mismatch),
        effects=tuple(effects),
        fit=FitSummary(FitFigures(*_figures(before, after)), held_out_figures(validation), expected_rms(full, after.rms)),
        geometry_alone=setup.geometry_alone,
        not_separable=not_separable,
        advice=(*left_out, *advice),
        dropped=setup.dropped,
        notes=(*said, *once, *evidence.untried),
        exclusion_limits=exclusion_limits(full, setup.possible, there),
        between_recordings=recordings,
        evidence=evidence,
        plot_data=plot_data(setup, full, mismatch, residual, residual_after),
    )


def held_out_figures(validation: CrossValidation) -> HeldOutFigures:
    """The figures of the centres that are not rejected, and of every centre where some are."""
    before, after = validation.before, validation.after
    figures = HeldOutFigures(*_figures(before, after), split=validation.split)
    if after.every <= after.count:
        return figures
    counts = replace(figures, centres=after.every, robust_centres=after.count)
    return replace(counts, every_before_rms_mm=before.rms_of_every, every_after_rms_mm=after.rms_of_every)


def named_alone(alike: Sequence[tuple[NotSeparable, EffectSet, EffectSet]]) -> list[tuple[Sequence[Member], Sequence[Member]]]:
    """Both sides of each pair by their parametric effects, with coefficients, where both have some."""
    sides = ([side.part(lambda m: m.candidate.name != UNKNOWN).with_coefficients for side in both] for _, *both in alike)
    return [(ours, theirs) for ours, theirs in sides if ours and theirs]


def not_found_again(effects: Sequence[EffectFound]) -> list[str]:
    """A sentence where parts of the recording do not show again what was found."""
    named = [f"{effect_in_words(e.name)} at {one.at}" for e in effects for one in e.found_again if not one.repeats]
    if not named:
        return []
    return [f"parts of the recording do not show {', '.join(named)} again: it is not explained by what one part of it shows"]


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


def verdict_of(full: ModelFit, effects: Sequence[EffectFound] = ()) -> str:
    """The verdict on a fit. It is ``none`` if the evidence of all effects is below that of noise alone, and ``cannot_tell`` if the evidence
    is above that and yet shows nothing, if another set is not excluded, or if time ran out before all sets were compared. Beside something
    unmodelled it is ``partly_explained`` if names that all these sets share explain a substantial share of the mismatch
    (``names_explain``), ``cannot_tell`` if only trends do, else ``unexplained`` or ``cannot_tell``.
    Joints that repeat worse than their data sheet has it are a mismatch of their own, and a name that a general function predicts better
    than is no explanation: the verdict is then neither ``none`` nor ``explained``.

    effects: as they are reported.
    """
    fit, noisy = full.evidence, joint_noise_factor(full) > 1.0
    if fit.cut_short:
        return "cannot_tell"
    if not fit.significant and not full.random:
        return "cannot_tell" if fit.undecided or noisy else "none"
    reported = reported_hypothesis(fit)
    others = alternatives_to(fit, reported, full.everywhere) if fit.significant else []
    open_ones = frozenset[str]().union(*(reported.labels - other.labels for other, _ in others))
    shared = [e for e in effects if open_ones.isdisjoint(label_of(e.name, where) for where in (e.where, *zip(e.where, strict=True)))]
    if full.random and names_explain(shared):
        return "partly_explained"
    if others:
        return "cannot_tell"
    if full.random:
        return "cannot_tell" if names_explain(shared, trends=True) else "unexplained"
    return "partly_explained" if noisy or better_in_general(fit, reported) else "explained"


def names_explain(effects: Sequence[EffectFound], trends: bool = False) -> bool:
    """Whether an effect of the catalogue removes a substantial share of the held-out excess over noise, beyond the expanded uncertainty of
    that share. An order that is not determined is one of its figures, and takes nothing from the name. trends: whether trends count.
    """
    shares = (e.held_out_gain - K * e.held_out_gain_std for e in effects if e.name != UNKNOWN and (trends or not e.trend))
    return max(shares, default=0.0) > OPTIONS.substantial


def with_alternatives(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects, each with the strongest others that could stand in its place. Unmodelled effects that stand at all locations have none:
    they stand beside each other.
    """
    fit = full.evidence
    reported = reported_hypothesis(fit)
    out = []
    for effect in effects:
        if full.everywhere and effect.name == UNKNOWN:
            out.append(effect)
            continue
        found: dict[str, float] = {}
        for where in effect.where if effect.name != UNKNOWN else effect.where[:1]:
            for label in labels_of(reported, effect.name, where):
                for other, odds in alternatives_of(fit, reported, label).items():
                    found[other] = max(odds, found.get(other, 0.0))
        best = sorted(found.items(), key=lambda item: -item[1])[: OPTIONS.beam]
        ranked = [Alternative.of_label(label, odds) for label, odds in best]
        out.append(replace(effect, alternatives=tuple(ranked)))
    return out


def labels_of(reported: Hypothesis, name: str, where: str) -> list[str]:
    """``name:where`` of the effects of this name of which ``where`` is a location."""
    mine = (m for m in reported.members if m.candidate.name == name and where in m.candidate.where)
    return list(dict.fromkeys(m.label for m in mine))


def averaged_over_sets(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects with the parameters as all sets state them that are not excluded."""
    if not full.evidence.significant:
        return list(effects)
    sets = BetweenSets.of(full.evidence)
    reported = reported_hypothesis(full.evidence)
    out = []
    for effect in effects:
        labels = [label for at in effect.where for label in labels_of(reported, effect.name, at)]
        out.append(
            effect if effect.name == UNKNOWN else replace(effect, parameters=sets.averaged(dict.fromkeys(labels), effect.parameters))
        )
    return out
