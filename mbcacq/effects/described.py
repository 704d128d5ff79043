"""Effects that are written down as functions of covariates, evaluated for a recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from mbcacq.effects.covariates import RECORDING, Covariates
from mbcacq.effects.effect import Candidate, Written
from mbcacq.effects.functions import OF_CENTRES, DescribedPart, Values, evaluate
from mbcacq.estimation.terms import PER_POSE, Part


def evaluated(covariates: Covariates, parts: Sequence[Written], value: Values | None = None) -> list[Part]:
    """The parts with their basis at the poses, or centres, of a recording; those that have their basis already stay as they are.

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
    obs, value = covariates.obs, value or cache(covariates.value)

    def at_centres(name: str) -> np.ndarray:
        return value(name) if name in OF_CENTRES else value(name)[obs.pose]

    def basis(part: DescribedPart) -> np.ndarray:
        if part.place in PER_POSE:
            return evaluate(part.columns, value, obs.n_poses)
        return evaluate(part.columns, at_centres, obs.n_centres)

    return [p if isinstance(p, Part) else Part(p.place, p.index, p.component, basis(p)) for p in parts]


def parts_of(candidate: Candidate, here: Covariates, hyper: float | None = None) -> list[Part]:
    """What a candidate displaces in a recording, at a value of its hyper-parameter."""
    return evaluated(here, candidate.parts(hyper))


def functions_of(candidate: Candidate, here: Covariates, values: np.ndarray) -> np.ndarray:
    """(H, P, f): the functions of a candidate with ``components``, at values (H,) of its hyper-parameter."""
    return evaluate(candidate.functions(values), cache(here.value), here.obs.n_poses)


def can_be_kept(candidate: Candidate, hyper: float | None = None) -> bool:
    """Whether an effect means the same in another recording: it is written down, and does not tell several recordings apart."""
    return all(isinstance(p, DescribedPart) and RECORDING not in p.covariates for p in candidate.parts(hyper))
