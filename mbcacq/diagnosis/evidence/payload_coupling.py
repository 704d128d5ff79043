"""A wrong payload and the elastic joints that show it, solved together.

A joint gives way by c (tau + U p): compliance times the torque of the declared payload and of the payload's error p. It is linear in c for
a given p and in p for given c; so both are solved in turns at the point reached (Gauss-Newton). What is reported is the last such problem
written with the declared torque, in which mass and centre of mass stand for themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.coefficients import Coefficients, coefficients
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part
from mbcacq.effects.pose import joint_compliance, payload


def coupled(candidates: list[Candidate], context: Context, best: Hypothesis) -> Hypothesis:
    """The set with compliances and payload that agree with each other; the set itself where it has no wrong payload. candidates: of the
    recording.

    Every loaded joint is elastic in this, significantly or not, so that the payload's uncertainty contains theirs.
    """
    if all(m.candidate.name != payload.NAME for m in best.members):
        return best
    loaded = {(f"A{i + 1}",) for i in payload.loaded_joints(context)}
    there = {m.candidate.where for m in best.members if m.candidate.name == joint_compliance.NAME}
    soft = [c for c in candidates if c.name == joint_compliance.NAME and c.where in loaded | there]
    others = [m for m in best.members if m.candidate.name not in (payload.NAME, joint_compliance.NAME)]

    def together(*chosen: Candidate) -> Hypothesis:
        return replace(best, members=(*others, *(Member(c, None, size=OPTIONS.sizes[-1]) for c in chosen)))

    elastic = compliances(together(*soft))
    unit, correction, covariance = payload.unit_torques(context), np.zeros(4), None
    for number in range(OPTIONS.rounds):
        torque = context.gravity_torque + unit @ correction
        tool = payload.correction_for(context, elastic, complete=True)[0]
        new = together(*(under_torque(c, torque, number) for c in soft), tool)
        found = coefficients(new)
        step, covariance = found.mean[found.slices[-1]], found.covariance[found.slices[-1], found.slices[-1]]
        correction = correction + step
        elastic = compliances(new, found)
        if np.all(np.abs(step) < OPTIONS.steady * np.sqrt(np.diag(covariance))):
            break
    return together(*soft, payload.correction_for(context, elastic, covariance, complete=True)[0])


def under_torque(candidate: Candidate, torque: np.ndarray, number: int) -> Candidate:
    """An elastic joint under other torques (P, n) N m than declared."""
    i = int(candidate.where[0][1:]) - 1
    variant = f"heavy {number} {torque[:, i].sum():.9g}"
    return replace(candidate, build=lambda _: [Part("joint", i, 0, torque[:, i : i + 1])], variant=variant)


def compliances(hypothesis: Hypothesis, known: Coefficients | None = None) -> dict[int, float]:
    """Index of the joint -> rad/Nm, to four digits; none below a share of the softest."""
    solved = known or coefficients(hypothesis)
    found = {
        int(m.candidate.where[0][1:]) - 1: float(solved.mean[p.start])
        for m, p in zip(hypothesis.members, solved.slices, strict=True)
        if m.candidate.name == joint_compliance.NAME
    }
    least = max(OPTIONS.undecided * max(found.values()), 1e-9)  # a loaded joint gives way: none is that much stiffer than another
    return {i: float(f"{max(value, least):.4g}") for i, value in found.items()}
