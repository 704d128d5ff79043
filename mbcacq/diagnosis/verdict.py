"""From what was found and proven to what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output import next_measurements
from mbcacq.diagnosis.output.alternatives import rivals, unseen
from mbcacq.diagnosis.output.contributions import Contributions
from mbcacq.diagnosis.output.effects_table import mismatch_list, named_effects, unknown_effects, where_it_is
from mbcacq.diagnosis.output.plot_data import evidence_of
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Diagnosis, EffectFound
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore, predicts_better, training_score

# Share of the held-out excess that a name must remove to be told beside a mismatch without one: a larger, and a smaller one.
LEAST = {"unexplained": 0.05, "partly_explained": 0.005}
WEAK = 20.0  # score up to which a name may be chance, and is proven with more of the data: it might not be found in three quarters of them


def conclude(setup: DiagnosisProblem, full: ModelFit, proof: CrossValidation) -> Diagnosis:
    if proof.not_predictive:
        kept = full.model.without(proof.not_predictive)
        full = replace(full, model=BeamSearch(setup.candidates).solved(full.geometry_only, kept.effects))
    before, left_before = training_score(full.geometry_only, NO_EFFECTS, None)
    after, left_after = training_score(full.geometry_only, full.model, full.smooth)
    worth = Contributions(full if full.cells else replace(full, smooth=None))  # groups at every place could do what names do
    effects = named_effects(full, worth, proof)
    verdict, places = verdict_of(full), mismatch_list(full, worth, before)
    first, last = proof.decisive
    useless = not predicts_better(last, first)
    if useless:  # what predicts nothing better on data that took no part is not told; that there is something may be, where it was plain
        effects, after, proof = [], before, replace(proof, after=proof.before)
        weak = verdict == "explained" and full.model.penalised_gain < WEAK
        verdict, places = ("none", []) if weak else ("none" if verdict == "none" else "unexplained", places)
    if (first if useless else last).chi2_dof > OPTIONS.noise_like_chi2:
        verdict = {"explained": "partly_explained", "none": "unexplained"}.get(verdict, verdict)
    if verdict == "unexplained" and not places:
        places = mismatch_list(full, worth, before, anything=True)
    effects = worth_telling(effects, verdict)
    effects += [] if useless else unknown_effects(full, worth, proof)
    if verdict == "unexplained" and not effects:
        effects = where_it_is(places)
    alternatives, inseparable, pairs = rivals(setup, full) if effects else ({}, [], [])
    for effect in effects:
        effect.alternatives = alternatives.get(effect.name, [])
    hints = next_measurements.separate(setup.context, pairs)
    if verdict == "explained" and inseparable:
        verdict = "cannot_tell"
    if verdict == "none":
        for candidate, seen, hopeless in unseen(setup, full):
            hints.append(next_measurements.show(setup.context, candidate))
            if hopeless:
                verdict = "cannot_tell"
                inseparable.append(
                    {
                        "effects": [f"{candidate.name}:{'+'.join(candidate.where)}", "geometry and station poses"],
                        "correlation": float(np.sqrt(1 - seen)),
                    }
                )
    fit = {
        "train": in_words(before, after),
        "held_out": {**in_words(proof.before, proof.after), "split": proof.split},
        "repeatability_floor_mm": expected_rms(full, after.rms),
    }
    shown = evidence_of(setup, full, left_before, left_after)
    return Diagnosis(verdict, places, effects, fit, inseparable, hints, setup.dropped, notes(setup, full), shown)


def worth_telling(effects: list[EffectFound], verdict: str) -> list[EffectFound]:
    """What describes next to nothing of a mismatch is no name for it."""
    return [e for e in effects if e.held_out_gain >= LEAST.get(verdict, -np.inf)]


def in_words(before: PredictiveScore, after: PredictiveScore) -> dict[str, float]:
    return {"before_rms_mm": before.rms, "after_rms_mm": after.rms, "before_chi2_dof": before.chi2_dof, "after_chi2_dof": after.chi2_dof}


def expected_rms(full: ModelFit, fallback: float) -> float:
    """3D rms (mm) that the estimated noise alone makes at one centre."""
    linear, noise = full.geometry_only.linear, full.noise
    joint = np.sum((linear.joint[:, :3] * noise.joint) ** 2, axis=(1, 2))
    return float(np.sqrt(np.mean(joint[linear.keep]) + np.sum(noise.point**2))) if linear.keep.any() else fallback


def verdict_of(full: ModelFit) -> str:
    """Names that survive beside what has no name explain in part, if they explain most of it."""
    structure = full.smooth is not None or (full.residual_tests is not None and full.residual_tests.structure and not full.cells)
    if not full.model.effects:
        return "unexplained" if structure else "none"
    if not structure:
        return "explained"
    worth = Contributions(full)
    if full.smooth is None:
        rest = full.residual_tests.evidence.best()
        return "partly_explained" if full.model.gain > max(rest.gain - rest.used, 0.0) else "unexplained"
    names, groups = list(range(worth.effects)), list(range(worth.effects, len(worth.parts)))
    if not full.cells:  # a long recording: groups stand everywhere and could do what names do, which were there first
        return "partly_explained" if full.model.gain > 0.5 * worth.total else "unexplained"
    return "partly_explained" if worth.of(names) > worth.of(groups) else "unexplained"


def notes(setup: DiagnosisProblem, full: ModelFit) -> list[str]:
    out = [f"{name} was not considered: {reason}" for name, reason in setup.dropped.items()]
    keep = full.geometry_only.linear.keep
    dropped = int(np.sum(~keep))
    if dropped:
        out.append(f"{dropped} of {len(keep)} measured centres are gross outliers and were set aside")
    if not setup.context.masses_known:
        out.append(
            "no masses given: elasticity under gravity was tested with one kilogram halfway along each link, "
            "its size in rad/Nm is not meaningful"
        )
    return out
