"""Effects that these poses cannot observe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.effects.effect import Candidate

OBSERVABLE = 2.0  # chi2 that an effect of typical size must make at least, or it would not be observed even several times as large
STRONG = 10.0  # times the typical size


@dataclass(frozen=True)
class Unobservable:
    """An effect that these poses cannot observe at its typical size.

    share: of its squared displacements that the free geometry does not absorb. even_strong: not at STRONG times that size either. poses:
    number of poses like these that would show it at STRONG times its size.
    """

    candidate: Candidate
    share: float
    even_strong: bool
    poses: int


def unobservable(setup: DiagnosisProblem, full: ModelFit) -> list[Unobservable]:
    """The compliance of the joint with the largest range of gravity torque, if these poses cannot observe it."""
    if not setup.context.masses_known:
        return []
    elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
    most_loaded = sorted(elastic, key=lambda c: -np.ptp(setup.context.gravity_torque[:, int(c.where[0][1:]) - 1]))[:1]
    out = []
    for candidate in most_loaded:
        X, normal, _ = full.geometry_only.candidate_products(candidate, None)
        information = float(normal[0, 0])
        chi2 = candidate.typical[0] ** 2 * information
        if chi2 < OBSERVABLE:
            share = float(np.clip(information / np.sum(X * X), 0, 1))
            poses = int(np.ceil(setup.linear.obs.n_poses * OBSERVABLE / max(STRONG**2 * chi2, 1e-12)))
            out.append(Unobservable(candidate, share, bool(STRONG**2 * chi2 < OBSERVABLE), poses))
    return out
