"""Effects that are written down as functions of covariates, evaluated for a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mbcacq.effects.covariates import OF_CENTRES, Covariates
from mbcacq.effects.functions import DescribedPart, Values, evaluate
from mbcacq.estimation.terms import PER_POSE, Part


def evaluated(covariates: Covariates, parts: Sequence[DescribedPart], value: Values | None = None) -> list[Part]:
    """The parts with their basis at the poses, or centres, of a recording. value: name of a covariate -> its values, where they are not
    those of the recording. Raises Missing where the recording lacks a covariate.
    """
    obs, value = covariates.obs, value or covariates.value

    def at_centres(name: str) -> np.ndarray:
        return value(name) if name in OF_CENTRES else value(name)[obs.pose]

    return [
        Part(
            part.place,
            part.index,
            part.component,
            evaluate(part.columns, value, obs.n_poses) if part.place in PER_POSE else evaluate(part.columns, at_centres, obs.n_centres),
        )
        for part in parts
    ]


def built(covariates: Covariates, parts: Sequence[DescribedPart]) -> Callable[[float | None], list[Part]]:
    """What ``Candidate.build`` of an effect without hyper-parameter is; evaluated when it is first called."""
    kept: list[Part] = []

    def build(_: float | None) -> list[Part]:
        if not kept:
            kept.extend(evaluated(covariates, parts))
        return list(kept)

    return build
