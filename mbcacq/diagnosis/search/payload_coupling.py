"""A wrong payload and the elastic joints that show it, solved together.

A joint gives way by c (tau + U p): compliance times the torque of the declared payload and of the payload's error p. It is linear in c for
a given p and in p for given c; so both are solved in turns at the point reached (Gauss-Newton). What is reported is the last such problem
written with the declared torque, in which mass and centre of mass stand for themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.search.solution import solved
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part
from mbcacq.effects.pose import joint_compliance, payload

LEAST_COMPLIANCE = 0.02  # of the softest joint: no loaded joint is stiffer than that


def coupled(candidates: list[Candidate], context: Context, projected: CandidateScoring, model: EffectSet) -> EffectSet:
    """The set with compliances and payload that agree with each other; the set itself where it has no wrong payload. candidates: of the
    recording.

    Every loaded joint is elastic in this, significantly or not, so that the payload's uncertainty contains theirs.
    """
    if payload.NAME not in model.names:
        return model
    loaded = {(f"A{i + 1}",) for i in payload.loaded_joints(context)}
    there = {c.where for c, _ in model.effects if c.name == joint_compliance.NAME}
    soft = [c for c in candidates if c.name == joint_compliance.NAME and c.where in loaded | there]
    others = tuple((c, h) for c, h in model.effects if c.name not in (payload.NAME, joint_compliance.NAME))
    declared = tuple((c, None) for c in soft)
    elastic = compliances(solved(projected, (*others, *declared)))
    unit, correction, covariance = payload.unit_torques(context), np.zeros(4), None
    for number in range(OPTIONS.rounds):
        torque = context.gravity_torque + unit @ correction
        loaded_joints = tuple((under_torque(c, torque, number), None) for c in soft)
        tool = payload.correction_for(context, elastic, complete=True)[0]
        new = solved(projected, (*others, *loaded_joints, (tool, None)))
        last = new.slices()[-1]
        step, covariance = new.coefficients[last], new.covariance[last, last]
        correction = correction + step
        elastic = compliances(new)
        if np.all(np.abs(step) < OPTIONS.steady * np.sqrt(np.diag(covariance))):
            break
    tool = payload.correction_for(context, elastic, covariance, complete=True)[0]
    return solved(projected, (*others, *declared, (tool, None)))


def under_torque(candidate: Candidate, torque: np.ndarray, number: int) -> Candidate:
    """An elastic joint under other torques (P, n) N m than declared."""
    i = int(candidate.where[0][1:]) - 1
    variant = f"heavy {number} {torque[:, i].sum():.9g}"
    return replace(candidate, build=lambda _: [Part("joint", i, 0, torque[:, i : i + 1])], variant=variant)


def compliances(model: EffectSet) -> dict[int, float]:
    """Index of the joint -> rad/Nm, to four digits; none below a share of the softest."""
    found = {
        int(c.where[0][1:]) - 1: float(model.coefficients[p.start])
        for (c, _), p in zip(model.effects, model.slices(), strict=True)
        if c.name == joint_compliance.NAME
    }
    least = max(LEAST_COMPLIANCE * max(found.values()), 1e-9)
    return {i: float(f"{max(value, least):.4g}") for i, value in found.items()}
