"""Effects that are written down as functions of covariates, evaluated for a recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from mbcacq.effects.covariates import UNSTATED, Covariates
from mbcacq.effects.effect import Candidate
from mbcacq.effects.functions import OF_CENTRES, Column, DescribedPart, Known, Values, evaluate
from mbcacq.estimation.terms import PER_POSE, Part


class Evaluation:
    """Columns evaluated at the poses, or the centres, of a recording; what several columns have in common is computed once.

    value: name of a covariate -> its values, where they are not those of the recording.
    """

    def __init__(self, covariates: Covariates, value: Values | None = None):
        self.obs, self.value = covariates.obs, value or cache(covariates.value)
        self._known: dict[bool, Known] = {True: {}, False: {}}

    def __call__(self, columns: Sequence[Column], per_pose: bool) -> np.ndarray:
        """(P, k) at the poses, or (M, k) at the centres. Raises Missing if the recording lacks a covariate."""
        values, rows = (self.value, self.obs.n_poses) if per_pose else (self.at_centres, self.obs.n_centres)
        return evaluate(columns, values, rows, self._known[per_pose])

    def at_centres(self, name: str) -> np.ndarray:
        """(M,) values of a covariate."""
        return self.value(name) if name in OF_CENTRES else self.value(name)[self.obs.pose]


def evaluated(covariates: Covariates, parts: Sequence[DescribedPart], value: Values | None = None) -> list[Part]:
    """The parts with their basis at the poses, or centres, of a recording.

    Parameters
    ----------
    covariates
        Covariates of the recording.
    parts
        Parts of an effect.
    value
        Name of a covariate -> its values, where they are not those of the recording.

    Raises
    ------
    Missing
        If the recording lacks a covariate.
    """
    basis = Evaluation(covariates, value)
    return [Part(p.place, p.index, p.component, basis(p.columns, p.place in PER_POSE)) for p in parts]


def parts_of(candidate: Candidate, here: Covariates, hyper: float | None = None) -> list[Part]:
    """What a candidate displaces in a recording, at a value of its hyper-parameter."""
    return evaluated(here, candidate.parts(hyper))


def functions_of(candidate: Candidate, here: Covariates, values: np.ndarray) -> np.ndarray:
    """(H, P, f): the functions of a candidate with ``components``, at values (H,) of its hyper-parameter."""
    return evaluate(candidate.functions(values), cache(here.value), here.obs.n_poses)


def can_be_kept(candidate: Candidate, hyper: float | None = None) -> bool:
    """Whether an effect means the same in another recording: it does not tell several recordings apart, nor follow a fitted geometry."""
    return all(p.covariates.isdisjoint(UNSTATED) for p in candidate.parts(hyper))
