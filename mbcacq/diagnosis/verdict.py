"""The verdict: from the fitted model and its cross-validation to what is reported."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence_verdict import pairs_not_separable, verdict_by_evidence, with_alternatives, with_other_locations
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.output.between_recordings import between_recordings
from mbcacq.diagnosis.output.contributions import Contributions
from mbcacq.diagnosis.output.effects_table import (
    classes,
    mismatch_table,
    parametric_effects,
    suspected_effect,
    unmodelled_effects,
    with_classes,
    with_significance,
)
from mbcacq.diagnosis.output.exclusion_limits import exclusion_limits, limited_effects, says_too_little
from mbcacq.diagnosis.output.kept_model import kept_model
from mbcacq.diagnosis.output.next_measurements import SizedEffect, elsewhere, revealing, separating
from mbcacq.diagnosis.output.notes import not_carried_over, notes, of_effects, sum_of_shares
from mbcacq.diagnosis.output.pictures import plot_data
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Diagnosis, EffectFound, FitFigures, FitSummary, HeldOutFigures, MismatchEntry, NotSeparable
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.search.solution import solved
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore, predicts_better, training_score
from mbcacq.effects.effect_model import EffectModel

# Share of the held-out excess that a parametric effect must remove to be reported although an unmodelled effect is there: where the
# unmodelled one is the larger of the two, and where it is the smaller.
LEAST = {"unexplained": 0.05, "partly_explained": 0.005}


@dataclass(frozen=True)
class JudgedFit:
    """What is reported of a fit. full, proof: of the effects that are left. before: score on the data fitted with geometry alone, which
    leaves residual (M, R). model: the reported effects, to be kept; None where there are none.
    """

    full: ModelFit
    proof: CrossValidation
    before: PredictiveScore
    residual: np.ndarray
    findings: Findings
    model: EffectModel | None


def judge(setup: DiagnosisProblem, full: ModelFit, proof: CrossValidation) -> JudgedFit:
    """What is reported of a fit whose cross-validation is ``proof``."""
    if proof.not_predictive:
        kept = full.model.without(proof.not_predictive)
        full = replace(full, model=solved(full.geometry_only, kept.effects))
    before, residual = training_score(replace(full, model=NO_EFFECTS).without_random_effects().joint)
    findings = by_evidence(full, full.evidence, proof, before) if full.residual_tests is None else by_prediction(full, proof, before)
    return JudgedFit(full, proof, before, residual, findings, kept_model(setup, full, findings.effects) or None)


def conclude(setup: DiagnosisProblem, fit: JudgedFit) -> Diagnosis:
    """The diagnosis of a fit that was judged: scores, uncertainties, advice, limits of what was not found."""
    full, proof, before, judged = fit.full, fit.proof, fit.before, fit.findings
    after, residual_after = training_score(full.joint)
    if not judged.predictive:
        after, proof = before, replace(proof, after=proof.before)
    there = elsewhere(setup.context)
    limited = limited_effects(setup, full, there)
    # That nothing was found says little where little could have been.
    too_little = says_too_little(limited, setup.linear.obs.n_poses) if judged.verdict == "none" else None
    verdict = judged.verdict if too_little is None else "cannot_tell"
    advice = separating(setup.context, there, judged.pairs) if too_little is None else revealing(there, limited)
    reported = with_significance(judged.effects, setup, full)
    effects, mismatch = with_classes(reported, judged.mismatch, classes(full.geometry_only.linear.obs, judged.not_separable))
    return Diagnosis(
        verdict=verdict,
        mismatch=tuple(mismatch),
        effects=tuple(effects),
        fit=FitSummary(
            train=FitFigures(*_figures(before, after)),
            held_out=HeldOutFigures(*_figures(proof.before, proof.after), split=proof.split),
            repeatability_floor_mm=expected_rms(full, after.rms),
        ),
        geometry_alone=setup.geometry_alone,
        not_separable=judged.not_separable,
        advice=tuple(advice),
        dropped=setup.dropped,
        notes=(
            *not_carried_over(verdict, proof),
            *sum_of_shares(mismatch, before, after),
            *notes(setup, full),
            *of_effects(setup, full, judged.effects),
            *([] if too_little is None else [too_little]),
        ),
        exclusion_limits=exclusion_limits(limited, there),
        between_recordings=between_recordings(full),
        model=fit.model,
        plot_data=plot_data(setup, full, mismatch, fit.residual, residual_after),
    )


def by_evidence(full: ModelFit, fit: EvidenceFit, proof: CrossValidation, before: PredictiveScore) -> Findings:
    """What the evidence says, of a recording that was searched as a whole; held-out figures are reported beside it."""
    contributions = Contributions(full)
    effects = parametric_effects(full, contributions, proof) + unmodelled_effects(full, contributions, proof)
    not_separable, pairs = pairs_not_separable(fit) if fit.significant else ((), ())
    mismatch = mismatch_table(full, contributions, before)
    return Findings(verdict_by_evidence(full, fit), mismatch, list(with_alternatives(fit, effects)), True, not_separable, pairs)


@dataclass(frozen=True)
class Findings:
    """What is reported of a fit. predictive: whether the model predicts held-out data better than the geometry alone does."""

    verdict: str
    mismatch: list[MismatchEntry]
    effects: list[EffectFound]
    predictive: bool
    not_separable: tuple[NotSeparable, ...] = ()
    pairs: tuple[tuple[SizedEffect, SizedEffect], ...] = ()


def by_prediction(full: ModelFit, proof: CrossValidation, before: PredictiveScore) -> Findings:
    """What is reported of a long recording, whose evidence grows without limit: effects that predict data left out."""
    # Groups that act at every location could do what parametric effects do: they are left out of the contributions.
    contributions = Contributions(full.without_random_effects())
    verdict, mismatch = verdict_of_long_recording(full), mismatch_table(full, contributions, before)
    geometry_alone, with_effects = proof.decisive
    predictive = predicts_better(with_effects, geometry_alone)
    effects = []
    if predictive:
        effects = reportable(parametric_effects(full, contributions, proof), verdict) + unmodelled_effects(full, contributions, proof)
    elif verdict != "none":  # effects that predict nothing are not reported; that something is there is
        verdict, effects = "unexplained", suspected_effect(mismatch)
    compared = with_other_locations(full.residual_tests, with_alternatives(full.evidence, effects))
    return Findings(verdict, mismatch, list(compared), predictive)


def reportable(effects: list[EffectFound], verdict: str) -> list[EffectFound]:
    """The parametric effects without those that remove next to nothing of a mismatch that is not explained."""
    return [e for e in effects if e.held_out_gain >= LEAST.get(verdict, -np.inf)]


def _figures(before: PredictiveScore, after: PredictiveScore) -> tuple[float, float, float, float]:
    return before.rms, after.rms, before.chi2_dof, after.chi2_dof


def expected_rms(full: ModelFit, fallback: float) -> float:
    """3D rms (mm) expected at one centre from the estimated noise alone; fallback: where no centre was kept."""
    linear, noise = full.geometry_only.linear, full.noise
    joint = np.sum((linear.joint_columns[:, :3] * noise.joint) ** 2, axis=(1, 2))
    return float(np.sqrt(np.mean(joint[linear.keep]) + np.sum(noise.point**2))) if linear.keep.any() else fallback


def verdict_of(full: ModelFit) -> str:
    """The verdict on the data of the fit."""
    return verdict_by_evidence(full, full.evidence) if full.residual_tests is None else verdict_of_long_recording(full)


def verdict_of_long_recording(full: ModelFit) -> str:
    """The verdict on the data of the fit: parametric effects, which were selected first, explain partly where they gain more than half of
    what they and unmodelled effects at all locations gain together.
    """
    if not full.model.effects:
        return "unexplained" if full.random else "none"
    if not full.random:
        return "explained"
    return "partly_explained" if full.model.gain > 0.5 * Contributions(full).total else "unexplained"
