"""The effects of a diagnosis as a model that can be kept: what ``mbcacq.diagnosis.result.Diagnosis.model`` holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.output.over_whole_range import over_whole_range
from mbcacq.diagnosis.search.bayes_factor import prior_sigma
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.effects import catalogue, unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import can_be_kept
from mbcacq.effects.effect import Candidate, label_of
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import UNKNOWN, EffectTerm, LearntRecording, key_of
from mbcacq.effects.functions import LEAST_PERIODS, OF_MECHANISMS, DescribedPart, periods_covered
from mbcacq.effects.in_words import effect_in_words
from mbcacq.effects.learnt_range import learnt_ranges, loads, with_a_range
from mbcacq.effects.unmodelled import unit_of
from mbcacq.model.observations import Observations


def kept_model(full: ModelFit) -> EffectModel:
    """The effects of a fit as terms: what was judged is what is kept."""
    obs = full.geometry_only.linear.obs
    if full.everywhere:
        return with_groups_everywhere(obs, full.model)
    here = Covariates(obs)
    unknown = unmodelled_terms(here, reported_hypothesis(full.evidence)) if full.random else []
    return _model(obs, [*named_terms(here, full.model), *unknown])


def predicting_better(kept: EffectModel, full: ModelFit, validation: CrossValidation) -> tuple[EffectModel, list[str]]:
    """The effects without which held-out data are predicted worse, by misfit and by chi2, and a sentence on each of the others: these have
    no place in a calibration.

    Most models that were found without a part may lack an effect, and say nothing of it: then it is judged with its coefficients fitted
    without the part.
    What happens at one station alone is not known where whole stations are left out, and stays. Two effects may describe one thing, and
    held-out data are then predicted as well without either. They stay if nothing else is left and both together predict better.
    """
    whole = validation.parametric or validation.after
    of_stations = validation.split == "station"

    def helps(t: EffectTerm) -> bool:
        if of_stations and "station" in t.covariates:
            return True
        if t.name == UNKNOWN and full.everywhere:
            return validation.after.better_than(whole)
        labels = (f"{t.name}:{t.where[0]}",) if t.name == UNKNOWN else (label_of(t.name, t.where), t.name)
        key = next((label for label in labels if label in validation.without), "")
        with_it, without = validation.refitted.get(key, (whole, validation.without.get(key)))
        return without is None or with_it.better_than(without)

    chosen = kept.select(helps)
    if not chosen and validation.after.better_than(validation.before):
        chosen = kept
    places = dict.fromkeys(label_of(t.name, t.where) for t in kept.terms if t not in chosen.terms)
    if UNKNOWN in {label.partition(":")[0] for label in places} and full.everywhere:
        places = {label: None for label in places if not label.startswith(UNKNOWN)} | {UNKNOWN: None}
    return chosen, [f"{effect_in_words(p)} is not kept for a calibration: held-out data are predicted no better with it" for p in places]


def with_groups_everywhere(obs: Observations, found: EffectSet) -> EffectModel:
    """Effects of a long recording, with groups at all locations. The groups have no size yet: a calibration with them gives it."""
    here = Covariates(obs)
    named = named_terms(here, found)
    return _model(obs, [*named, *everywhere(here, named)])


def _model(obs: Observations, terms: Sequence[EffectTerm]) -> EffectModel:
    return EffectModel(obs.cell.robot, tuple(terms), LearntRecording.of(obs), obs.cell.measurement)


def named_terms(here: Covariates, found: EffectSet) -> list[EffectTerm]:
    """The effects of the catalogue that can be kept."""
    terms: list[EffectTerm] = []
    for m, own in zip(found.members, found.slices(), strict=True):
        if can_be_kept(m.candidate, m.hyper):
            variance = np.diag(found.covariance[own, own])
            terms.append(term_of(here, m.candidate, m.hyper, found.coefficients[own], np.sqrt(np.maximum(variance, 0.0))))
    return terms


def everywhere(here: Covariates, named: list[EffectTerm]) -> list[EffectTerm]:
    """The groups of a long recording, without those that a named effect describes: a second description of one error takes it away from
    the first.
    """
    described = {(t.where, t.depends_on) for t in named if catalogue.declaration(t.name).same_as_group}
    return [g for g in unmodelled.carried(unmodelled.everywhere(here)) if (g.where, g.depends_on) not in described]


def unmodelled_terms(here: Covariates, hypothesis: Hypothesis) -> list[EffectTerm]:
    """The unmodelled effects of a hypothesis. Two functions of one joint by one angle or load are one process."""
    found, out = hypothesis.solved, dict[str, EffectTerm]()
    for m, own in zip(hypothesis.members, found.slices(), strict=True):
        if m.candidate.name == UNKNOWN and can_be_kept(m.candidate, m.hyper):
            term = term_of(here, m.candidate, m.hyper, found.coefficients[own], np.sqrt(np.diag(found.covariance)[own]))
            out |= {t.key: t for t in over_whole_range(here, replace(term, sigma=m.size * m.candidate.typical))}
    return list(out.values())


def term_of(here: Covariates, candidate: Candidate, hyper: float | None, coefficients: np.ndarray, std: np.ndarray) -> EffectTerm:
    """A candidate at its hyper-parameter as a term.

    Its covariates are held at the ends of the range in which it was learnt: beyond, it goes on as a constant, whatever its functions do.
    A constant is what the zero of a joint or the place of a frame is as well, so it does not matter where the functions have their zero,
    as it would if they faded. A periodic effect of the catalogue of which a period and more was seen is a law, and has no range. What a
    load winds up is proportional to it (Hooke), and compliances repeat between recordings where little else does: they go on, uncertain. So
    does the spring of a balancer, by the geometry of its levers.
    """
    parts, k = candidate.parts(hyper), candidate.k
    values = {candidate.hyper.name: float(hyper)} if candidate.hyper is not None and hyper is not None else {}
    key = key_of(candidate.name, candidate.where, candidate.depends_on, candidate.variant, values)
    functions = [f for part in parts for column in part.columns for product in column for f in product.functions]
    mechanism = {f.covariate for f in functions if f.kind in OF_MECHANISMS}
    laws = (*loads({f.covariate for f in functions}), *sorted(mechanism)) if candidate.name != UNKNOWN else ()
    return EffectTerm(
        name=candidate.name,
        where=candidate.where,
        depends_on=candidate.depends_on,
        parts=parts,
        names=(key,) if k == 1 else tuple(f"{key}[{j}]" for j in range(k)),
        units=tuple(_unit(next(p for p in parts if p.columns[j]), j) for j in range(k)),
        coefficients=np.array(coefficients, dtype=float),
        std=std,
        sigma=prior_sigma(candidate),
        typical=np.array(candidate.typical, dtype=float),
        variant=candidate.variant,
        hyper=values,
        ranges=learnt_ranges(here, parts),
        clamped=tuple(name for name in limited(here, candidate, hyper) if name not in laws),
        laws=laws,
    )


def limited(here: Covariates, candidate: Candidate, hyper: float | None) -> tuple[str, ...]:
    """The covariates beyond whose learnt range a candidate is held."""
    named = {name for part in candidate.parts(hyper) for name in part.covariates}
    law = candidate.periodic and candidate.name != UNKNOWN and not partly_covered(here, candidate, hyper)
    return with_a_range(named - {candidate.depends_on} if law else named)


def partly_covered(here: Covariates, candidate: Candidate, hyper: float | None) -> tuple[str, ...]:
    """The angle of a periodic error of which the recording shows less than a period: within its range it is a smooth function as
    good as any, beyond it nothing says that the error repeats.
    """
    if not candidate.periodic or hyper is None:
        return ()
    return (candidate.depends_on,) if periods_covered(here.value(candidate.depends_on), hyper) < LEAST_PERIODS else ()


def _unit(part: DescribedPart, j: int) -> str:
    """The unit of coefficient j of a part: of what it displaces, per unit of its covariate where it is in proportion to that."""
    per = {"gravity_torque": "/Nm", "gravity_moment": "/Nm", "payload_force": "/N", "qd": " s"}
    functions = [f for product in part.columns[j] for f in product.functions]
    linear = all(f.kind == "power" for f in functions) and all(product.functions for product in part.columns[j])
    of_covariate = (p for prefix, p in per.items() if linear and any(f.covariate.startswith(prefix) for f in functions))
    return unit_of(part) + next(of_covariate, "")
