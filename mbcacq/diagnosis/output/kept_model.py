"""The effects of a diagnosis as a model that can be kept: what ``mbcacq.diagnosis.result.Diagnosis.model`` holds."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import EffectFound
from mbcacq.diagnosis.search.projected_solve import prior_sigma
from mbcacq.effects import catalogue, unmodelled
from mbcacq.effects.covariates import TILT, Covariates
from mbcacq.effects.described import can_be_kept
from mbcacq.effects.effect import Candidate, Missing
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import UNKNOWN, EffectTerm, LearntRecording, key_of, learnt_ranges
from mbcacq.effects.functions import DescribedPart
from mbcacq.effects.periods import LEAST_PERIODS, periods_covered


def kept_model(setup: DiagnosisProblem, full: ModelFit, reported: list[EffectFound]) -> EffectModel:
    """The reported effects as terms. Groups for an unmodelled effect have no size yet: a calibration with them gives it."""
    obs = full.geometry_only.linear.obs
    here = Covariates(obs)
    names = {e.name for e in reported}
    terms: list[EffectTerm] = []
    for (candidate, hyper), own in zip(full.model.effects, full.model.slices(), strict=True):
        if candidate.name in names and can_be_kept(candidate, hyper):
            variance = np.diag(full.model.covariance[own, own])
            terms.append(term_of(here, candidate, hyper, full.model.coefficients[own], np.sqrt(np.maximum(variance, 0.0))))
    if UNKNOWN in names:
        terms += groups(setup, full, [e for e in reported if e.name == UNKNOWN], terms)
    return EffectModel(obs.cell.robot, tuple(terms), LearntRecording.of(obs), obs.cell.measurement)


def term_of(here: Covariates, candidate: Candidate, hyper: float | None, coefficients: np.ndarray, std: np.ndarray) -> EffectTerm:
    """A candidate at its hyper-parameter as a term."""
    parts = tuple(p for p in candidate.parts(hyper) if isinstance(p, DescribedPart))
    values = {candidate.hyper.name: float(hyper)} if candidate.hyper is not None and hyper is not None else {}
    key = key_of(candidate.name, candidate.where, candidate.depends_on, candidate.variant, values)
    k = candidate.k
    return EffectTerm(
        name=candidate.name,
        where=candidate.where,
        depends_on=candidate.depends_on,
        parts=parts,
        names=(key,) if k == 1 else tuple(f"{key}[{j}]" for j in range(k)),
        units=(_unit(parts[0]),) * k,
        coefficients=np.array(coefficients, dtype=float),
        std=std,
        sigma=prior_sigma(candidate),
        typical=np.array(candidate.typical, dtype=float),
        variant=candidate.variant,
        hyper=values,
        ranges=learnt_ranges(here, parts),
    )


def partly_covered(here: Covariates, candidate: Candidate, hyper: float | None) -> tuple[str, ...]:
    """The angle of a periodic error of which the recording shows less than a period: within its range it is a smooth function as
    good as any, beyond it nothing says that the error repeats.
    """
    if not candidate.periodic or hyper is None:
        return ()
    return (candidate.depends_on,) if periods_covered(here.value(candidate.depends_on), hyper) < LEAST_PERIODS else ()


def groups(setup: DiagnosisProblem, full: ModelFit, reported: list[EffectFound], named: list[EffectTerm]) -> list[EffectTerm]:
    """Groups of basis functions where unmodelled effects were reported, and the most probable process there; of a long recording at every
    location.
    """
    here = Covariates(full.geometry_only.linear.obs)
    if full.everywhere:
        # A second description of one error takes it away from the first.
        described = {(t.where, t.depends_on) for t in named if catalogue.declaration(t.name).same_as_group}
        return [g for g in unmodelled.carried(unmodelled.everywhere(here)) if (g.where, g.depends_on) not in described]
    found = [kept_group(here, at, e.depends_on) for e in reported for at in e.where]
    described = UnmodelledEffects(setup.design_blocks).processes(reported_hypothesis(full.evidence))
    return [*(unmodelled.process(here, m.candidate, m.size * m.candidate.typical) for m in described), *filter(None, found)]


def kept_group(here: Covariates, at: str, depends_on: str) -> EffectTerm | None:
    """The group of an unmodelled effect; None where it depends on what no other recording states (the place in the field), or on the
    artefact's tilt: eight functions of it along three axes are more than one recording teaches (13.5 instead of 9.9 um elsewhere, in
    cell 9138 of benchmarks/elsewhere.md).
    """
    if depends_on == TILT:
        return None
    try:
        return unmodelled.group(here, at, depends_on)
    except Missing:
        return None


def _unit(part: DescribedPart) -> str:
    """The unit of the coefficients of a part: of what it displaces, per unit of its covariate."""
    per = {"gravity_torque": "/Nm", "gravity_moment": "/Nm", "payload_force": "/N", "qd": " s"}
    linear = all(f.kind == "power" for column in part.columns for product in column for f in product.functions)
    of_covariate = (p for prefix, p in per.items() if linear and any(c.startswith(prefix) for c in part.covariates))
    return unmodelled.unit_of(part) + next(of_covariate, "")
