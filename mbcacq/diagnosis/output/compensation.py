"""What an effect that hides in a recording does elsewhere: with it goes what hid it.

An effect as large as its limit would show in the recording, were it alone. It hides where geometry, and the other effects that it is
confused with, compensate it there: they then have the values that do so, and act elsewhere as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.next_measurements import Elsewhere, SizedEffect
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem

Beside = Sequence[tuple[Candidate, float | None]]  # effects that are free, each at a value of its hyper-parameter


@dataclass(frozen=True)
class Compensation:
    """Geometry of a recording, in units of its prior sigma: Z (rows, z) whitened, normal Z'Z + I, and there (M, R, g) what its last g
    parameters, those that no station owns, do at the postures elsewhere.
    """

    problem: CandidateScoring
    there: Elsewhere
    Z: np.ndarray
    normal: np.ndarray
    geometry: np.ndarray

    @classmethod
    def of(cls, problem: CandidateScoring, there: Elsewhere) -> Compensation:
        columns, sigma = problem.linear.nuisance()
        Z = problem.whiten(columns * sigma)
        elsewhere = LinearProblem.of(there.linear.obs, there.linear.state, layout=problem.linear.layout)
        return cls(problem, there, Z, Z.T @ Z + np.eye(len(sigma)), elsewhere.geometry * elsewhere.sigma)

    def displacement(self, effect: SizedEffect, beside: Beside) -> np.ndarray | None:
        """(P, 3) mm: what is left elsewhere of an effect of the recording; None where it cannot be built there."""
        moved = self.there.displacement(effect)
        if moved is None:
            return None
        sizes = [OPTIONS.largest_usual * other.typical for other, _ in beside]
        blocks = [self.problem.block(other, value) * size for (other, value), size in zip(beside, sizes, strict=True)]
        C = np.concatenate([np.zeros((len(self.Z), 0)), *blocks], axis=1)
        x = self.problem.block(effect.candidate, effect.hyper) @ effect.coefficients
        across = self.Z.T @ C
        normal = np.block([[self.normal, across], [across.T, C.T @ C + np.eye(C.shape[1])]])
        taken = -np.linalg.solve(normal, np.concatenate([self.Z.T @ x, C.T @ x]))
        z, g = self.Z.shape[1], self.geometry.shape[2]
        moved = moved + self.geometry[:, :3] @ taken[z - g : z]
        ends = z + np.cumsum([0, *(len(size) for size in sizes)])
        for (other, value), size, first, end in zip(beside, sizes, ends[:-1], ends[1:], strict=True):
            also = self.there.displacement(SizedEffect(other, value, size * taken[first:end]))
            moved = moved if also is None else moved + also
        return moved
