"""A wrong tool and the elastic joints that show it, solved together.

A joint gives way by c (tau + U p): compliance times the torque of what is declared and of what the tool is more than that. Linear in c for
a given p and in p for given c; so both are solved in turns at the point reached (Gauss-Newton). What is told is the last such problem
written with the declared torque, in which mass and centre of mass stand for themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet, Members
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part
from mbcacq.effects.pose import joint_compliance, payload

ROUNDS = 20
LEAST_SOFT = 0.02  # of the softest joint: no loaded joint is stiffer than that
STILL = 0.05  # standard deviations by which the tool may still move


class EffectSetSolver(Protocol):
    """What is asked of a search: its candidates, and the solution of one set of effects together with the geometry."""

    @property
    def candidates(self) -> list[Candidate]: ...

    @property
    def situation(self) -> Context | None: ...

    def solve(self, screen: CandidateScoring, members: Members, permit: bool = False) -> EffectSet | None: ...


def settled(search: EffectSetSolver, screen: CandidateScoring, model: EffectSet) -> EffectSet:
    """The model with compliances and tool that agree with each other; the model itself where it has no wrong tool.

    Every loaded joint is elastic in this, significantly or not, so that the tool's uncertainty contains theirs.
    """
    situation = search.situation
    if situation is None or payload.NAME not in model.names:
        return model
    loaded = {(f"A{i + 1}",) for i in payload.loaded_joints(situation)}
    there = {c.where for c, _ in model.members if c.name == joint_compliance.NAME}
    soft = [c for c in search.candidates if c.name == joint_compliance.NAME and c.where in loaded | there]
    others = tuple((c, h) for c, h in model.members if c.name not in (payload.NAME, joint_compliance.NAME))
    declared = tuple((c, None) for c in soft)
    elastic = compliances(search.solve(screen, (*others, *declared), permit=True))
    unit, more, spread = payload.unit_torques(situation), np.zeros(4), None
    for turn in range(ROUNDS):
        torque = situation.gravity_torque + unit @ more
        heavy = tuple((under(c, torque, turn), None) for c in soft)
        tool = payload.correction_for(situation, elastic, complete=True)[0]
        new = search.solve(screen, (*others, *heavy, (tool, None)), permit=True)
        last = new.parts()[-1]
        step, spread = new.coefficients[last], new.covariance[last, last]
        more = more + step
        elastic = compliances(new)
        if np.all(np.abs(step) < STILL * np.sqrt(np.diag(spread))):
            break
    tool = payload.correction_for(situation, elastic, spread, complete=True)[0]
    return search.solve(screen, (*others, *declared, (tool, None)), permit=True)


def under(candidate: Candidate, torque: np.ndarray, turn: int) -> Candidate:
    """An elastic joint under other torques (P, n) N m than declared."""
    i = int(candidate.where[0][1:]) - 1
    return replace(candidate, build=lambda _: [Part("joint", i, 0, torque[:, i : i + 1])], variant=f"heavy {turn} {torque[:, i].sum():.9g}")


def compliances(model: EffectSet) -> dict[int, float]:
    """Index of the joint -> rad/Nm, to four digits; none below a share of the softest."""
    found = {int(c.where[0][1:]) - 1: float(model.coefficients[p.start]) for c, p in _soft(model)}
    least = max(LEAST_SOFT * max(found.values()), 1e-9)
    return {i: float(f"{max(value, least):.4g}") for i, value in found.items()}


def _soft(model: EffectSet) -> list[tuple[Candidate, slice]]:
    return [(c, p) for (c, _), p in zip(model.members, model.parts(), strict=True) if c.name == joint_compliance.NAME]
