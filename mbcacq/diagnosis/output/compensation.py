"""The error elsewhere of an effect that hides in a recording, with the change of geometry that hides it.

An effect as large as its limit would show in the recording, were it alone. It hides where geometry, and the other effects that it is
confused with, compensate it there: they then have the values that do so, and act elsewhere as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.next_measurements import Elsewhere
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem

Beside = Sequence[tuple[Candidate, float | None]]  # effects that are free, each at a value of its hyper-parameter


@dataclass(frozen=True)
class Compensation:
    """Geometry of a recording, in units of its prior sigma: Z (rows, z) whitened, and normal Z'Z + I. ``there`` (M, R, g) is the effect of
    its last g parameters, those that no station owns, at the postures elsewhere.
    """

    problem: CandidateScoring
    there: Elsewhere
    Z: np.ndarray
    normal: np.ndarray
    geometry: np.ndarray
    kept: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: CandidateScoring, there: Elsewhere) -> Compensation:
        columns, sigma = problem.linear.nuisance()
        Z = problem.whiten(columns * sigma)
        elsewhere = LinearProblem.of(there.linear.obs, there.linear.state, layout=problem.linear.layout)
        return cls(problem, there, Z, Z.T @ Z + np.eye(len(sigma)), elsewhere.geometry * elsewhere.sigma)

    def displacement(self, effect: Member, beside: Beside) -> np.ndarray | None:
        """(P, 3) mm: what is left elsewhere of an effect of the recording; None if it cannot be built there."""
        moved = self.there.displacement(effect)
        if moved is None:
            return None
        C, normal = self._with(effect.candidate, beside)
        x = self.problem.block(effect.candidate, effect.hyper) @ effect.coefficients
        taken = -np.linalg.solve(normal, np.concatenate([self.Z.T @ x, C.T @ x]))
        end, g = self.Z.shape[1], self.geometry.shape[2]
        moved = moved + self.geometry[:, :3] @ taken[end - g : end]
        for other, value in beside:
            first, end = end, end + other.k
            also = self.there.displacement(Member(other, value, coefficients=largest(other) * taken[first:end]))
            moved = moved if also is None else moved + also
        return moved

    def _with(self, candidate: Candidate, beside: Beside) -> tuple[np.ndarray, np.ndarray]:
        """Whitened columns C (rows, a) of the effects beside a candidate, in units of their largest size, and the normal matrix of geometry
        and these; kept for all bands of the candidate.
        """
        if candidate.key not in self.kept:
            self.kept.clear()
            blocks = [self.problem.block(other, value) * largest(other) for other, value in beside]
            C = np.concatenate([np.zeros((len(self.Z), 0)), *blocks], axis=1)
            across = self.Z.T @ C
            self.kept[candidate.key] = C, np.block([[self.normal, across], [across.T, C.T @ C + np.eye(C.shape[1])]])
        return self.kept[candidate.key]


def largest(other: Candidate) -> np.ndarray:
    """(k,) size up to which the coefficients of an effect that is free may be."""
    return OPTIONS.largest_usual * other.typical
