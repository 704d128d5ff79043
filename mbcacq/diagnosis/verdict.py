"""The verdict: from the fitted model and its cross-validation to what is reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.evidence.posterior import payload_instead, reported_hypothesis
from mbcacq.diagnosis.evidence_verdict import pairs_not_separable, verdict_by_evidence, with_alternatives
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output import interruptions, next_measurements
from mbcacq.diagnosis.output.aliased_orders import aliased
from mbcacq.diagnosis.output.between_recordings import between_recordings
from mbcacq.diagnosis.output.contributions import Contributions
from mbcacq.diagnosis.output.effects_table import mismatch_table, parametric_effects, unmodelled_effects
from mbcacq.diagnosis.output.exclusion_limits import LimitedEffect, exclusion_limits, limited_effects
from mbcacq.diagnosis.output.kept_model import kept_model, partly_covered
from mbcacq.diagnosis.output.next_measurements import SizedEffect
from mbcacq.diagnosis.output.noise_statement import stated_noise_is_wrong
from mbcacq.diagnosis.output.observability import Unobservable, unobservable
from mbcacq.diagnosis.output.plot_data import plot_data
from mbcacq.diagnosis.output.shares import sum_of_shares
from mbcacq.diagnosis.output.significance import classes, with_classes, with_significance
from mbcacq.diagnosis.output.sufficient_poses import MOST_POSES, says_too_little
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Advice, Diagnosis, EffectFound, FitFigures, FitSummary, HeldOutFigures, MismatchEntry, NotSeparable
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore, training_score
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.in_words import odds_in_words
from mbcacq.effects.pose import gear_transmission_error, warm_up
from mbcacq.estimation.variance_components import first_noise


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
    before, residual = training_score(replace(full, model=NO_EFFECTS).without_random_effects().joint)
    findings = by_evidence(full, full.evidence, proof, before)
    return JudgedFit(full, proof, before, residual, findings, kept_model(setup, full, findings.effects) or None)


def conclude(setup: DiagnosisProblem, fit: JudgedFit) -> Diagnosis:
    """The diagnosis of a fit that was judged: scores, uncertainties, advice, limits of what was not found."""
    full, proof, before, judged = fit.full, fit.proof, fit.before, fit.findings
    after, residual_after = training_score(full.joint)
    advice = next_measurements.separating(setup.context, judged.pairs)
    there = next_measurements.elsewhere(setup.context)
    limited = limited_effects(setup, full, there)
    silent = examined_silence(setup, full, limited) if judged.verdict == "none" else Silence(judged.verdict)
    not_separable = judged.not_separable + silent.not_separable
    reported = with_significance(judged.effects, setup, full)
    effects, mismatch = with_classes(reported, judged.mismatch, classes(full.geometry_only.linear.obs, not_separable))
    return Diagnosis(
        verdict=silent.verdict,
        mismatch=tuple(mismatch),
        effects=tuple(effects),
        fit=FitSummary(
            train=FitFigures(*_figures(before, after)),
            held_out=HeldOutFigures(*_figures(proof.before, proof.after), split=proof.split),
            repeatability_floor_mm=expected_rms(full, after.rms),
        ),
        geometry_alone=setup.geometry_alone,
        not_separable=not_separable,
        advice=(*advice, *silent.advice),
        dropped=setup.dropped,
        notes=(
            *not_carried_over(silent.verdict, proof),
            *sum_of_shares(mismatch, before, after),
            *notes(setup, full),
            *of_effects(setup, full, judged.effects),
            *silent.notes,
        ),
        exclusion_limits=exclusion_limits(limited, there),
        between_recordings=between_recordings(full),
        model=fit.model,
        plot_data=plot_data(setup, full, fit.residual, residual_after),
    )


@dataclass(frozen=True)
class Silence:
    """What is said where nothing was found: ``none``, or ``cannot_tell`` where too little could have been."""

    verdict: str
    advice: tuple[Advice, ...] = ()
    not_separable: tuple[NotSeparable, ...] = ()
    notes: tuple[str, ...] = ()


def examined_silence(setup: DiagnosisProblem, full: ModelFit, limited: Sequence[LimitedEffect]) -> Silence:
    """``none`` only of a recording that shows a soft joint and excludes half of the effects at their typical size."""
    poses, missed = setup.linear.obs.n_poses, unobservable(setup, full)
    advice = tuple(next_measurements.revealing(setup.context, m.candidate) for m in missed)
    absorbed = [m for m in missed if m.even_strong]
    notes = tuple(
        f"about {max(m.poses, poses + 1)} poses like these would show an elastic joint, were it soft"
        for m in absorbed
        if m.poses < MOST_POSES
    )
    too_little = says_too_little(limited, poses)
    if too_little is not None:
        notes = (*notes, too_little)
    verdict = "cannot_tell" if absorbed or too_little is not None else "none"
    return Silence(verdict, advice, tuple(_absorbed(m) for m in absorbed), notes)


def by_evidence(full: ModelFit, fit: EvidenceFit, proof: CrossValidation, before: PredictiveScore) -> Findings:
    """What the evidence says, of a recording that was searched as a whole; held-out figures are reported beside it."""
    contributions = Contributions(full)
    effects = parametric_effects(full, contributions, proof) + unmodelled_effects(full, contributions, proof)
    not_separable, pairs = pairs_not_separable(fit) if fit.significant else ((), ())
    mismatch = mismatch_table(full, contributions, before)
    return Findings(verdict_by_evidence(full, fit), mismatch, list(with_alternatives(fit, effects)), not_separable, pairs)


@dataclass(frozen=True)
class Findings:
    """What is reported of a fit."""

    verdict: str
    mismatch: list[MismatchEntry]
    effects: list[EffectFound]
    not_separable: tuple[NotSeparable, ...] = ()
    pairs: tuple[tuple[SizedEffect, SizedEffect], ...] = ()


def _absorbed(missed: Unobservable) -> NotSeparable:
    candidate = missed.candidate
    label = f"{candidate.name}:{'+'.join(candidate.where)}"
    return NotSeparable((label, "geometry and station poses"), float(np.sqrt(1 - missed.share)))


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


def confounded_pauses(setup: DiagnosisProblem, effects: Sequence[EffectFound]) -> list[str]:
    """Sentences on pauses of the recording that may explain a change that was found."""
    found = [p for e in effects for name, p in e.parameters.items() if name.rpartition(".")[2] == "at_pose"]
    moments = [(float(v), float(s)) for p in found for v, s in zip(np.atleast_1d(p.value), np.atleast_1d(p.std), strict=True)]
    return interruptions.confounded(setup.linear.obs, {e.name for e in effects}, moments)


def unfinished_warm_ups(setup: DiagnosisProblem, effects: Sequence[EffectFound]) -> list[str]:
    """Sentences on what fades with time so slowly that the recording shows only how it begins."""
    out = []
    for effect in effects:
        constants = [p for name, p in effect.parameters.items() if name.rpartition(".")[2] == warm_up.TIME_CONSTANT]
        if any(np.max(p.std) > 0.5 * np.ptp(setup.context.time) for p in constants):
            out.append(
                f"{effect.name} at {effect.where[0]}: the recording is too short for its time constant, and determines its size only "
                f"together with that; what was measured is the change within the recording"
            )
    return out


def partial_periods(setup: DiagnosisProblem, full: ModelFit) -> list[str]:
    """Sentences on periodic errors of which the recording covers less than a period."""
    out = []
    for candidate, hyper in full.model.effects:
        for name in partly_covered(setup.context, candidate, hyper):
            values = setup.context.value(name)
            share = gear_transmission_error.periods_covered(values, hyper or 0.0)
            low, high = np.degrees([values.min(), values.max()])
            out.append(
                f"{candidate.name} at {candidate.where[0]}, order {hyper:.3g}: the poses cover {share:.2f} of its period, so that it is a "
                f"smooth function of {name} from {low:.0f} to {high:.0f} deg and not shown to repeat beyond"
            )
    return out


def of_effects(setup: DiagnosisProblem, full: ModelFit, effects: Sequence[EffectFound]) -> list[str]:
    """Sentences on what qualifies the effects found."""
    if not effects:
        return []
    reported = reported_hypothesis(full.evidence)
    tool = payload_instead(full.evidence, reported)
    weigh = f"a payload other than declared explains as much as elastic joints ({odds_in_words(tool)}): weigh the tool" if tool else ""
    return [
        *partial_periods(setup, full),
        *aliased(setup, reported),
        *unfinished_warm_ups(setup, effects),
        *confounded_pauses(setup, effects),
        *([weigh] if weigh else []),
    ]


def not_carried_over(verdict: str, proof: CrossValidation) -> list[str]:
    """A sentence where a recording is explained and yet what is learnt from a part of it does not predict the rest down to noise."""
    left_out = proof.after
    if verdict != "explained" or left_out.chi2_dof <= OPTIONS.noise_like_chi2:
        return []
    part = "a place" if proof.split == "station" else "a part of the poses"
    return [
        f"{part} that is left out is predicted with {left_out.chi2_dof:.1f} times the variance that noise and fit allow: the effects "
        f"explain what was measured, and are not proven beyond it"
    ]


def unproven_places(setup: DiagnosisProblem) -> list[str]:
    """A sentence where all poses look at one place."""
    if not setup.context.scanner_on_flange or len(np.unique(setup.linear.obs.station)) > 1:
        return []
    return ["all poses look at one place: held-out figures are of that place, and that the model holds at other places is not proven"]


def notes(setup: DiagnosisProblem, full: ModelFit) -> list[str]:
    """Sentences on what was left out of the diagnosis."""
    out = [f"{name} was not considered: {reason}" for name, reason in setup.dropped.items()]
    wrong = stated_noise_is_wrong(full, first_noise(setup.linear.obs.cell))
    if wrong is not None:
        out.append(wrong)
    keep = full.geometry_only.linear.keep
    if open_ones := [u.name for u in setup.undetermined if not u.harmless]:
        out.append(f"the poses do not determine {', '.join(open_ones)}: held at the nominal value")
    dropped = int(np.sum(~keep))
    if dropped:
        out.append(f"{dropped} of {len(keep)} measured centres are gross outliers and were rejected")
    out += unproven_places(setup)
    if not setup.context.masses_known:
        out.append(
            "no masses given: elasticity under gravity was tested with one kilogram halfway along each link, "
            "its size in rad/Nm is not meaningful"
        )
    return out
