"""What effects displace in a recording, and the columns of its linear problem that follow."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.search.scanned_functions import Harmonics, PoseFunctions, ScannedFunctions, angle_of_harmonics
from mbcacq.effects.context import Context
from mbcacq.effects.described import functions_of, parts_of
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import Part


def covariates(linear: LinearProblem) -> Context:
    """Covariates of the recording, computed once for a linearisation."""
    return linear.computed_once("covariates", lambda: Context(linear.obs, linear.state, linear.prediction))


def candidate_parts(linear: LinearProblem, candidate: Candidate, hyper: float | None = None) -> list[Part]:
    """What a candidate displaces at a value of its hyper-parameter."""
    return parts_of(candidate, covariates(linear), hyper)


def candidate_columns(linear: LinearProblem, candidate: Candidate, hyper: float | None = None) -> np.ndarray:
    """(M, R, k): change of the prediction by each coefficient of a candidate."""
    return linear.columns(candidate_parts(linear, candidate, hyper))


def scanned_functions(linear: LinearProblem, candidate: Candidate, values: np.ndarray) -> ScannedFunctions:
    """The functions of a candidate with components, at values (H,) of its hyper-parameter. The grid is scanned many times: its functions
    are kept.
    """
    if candidate.hyper is None or values is not candidate.hyper.values:
        return functions_at(candidate, covariates(linear), values)
    return linear.computed_once(("functions", candidate.key), lambda: functions_at(candidate, covariates(linear), values))


def functions_at(candidate: Candidate, here: Context, values: np.ndarray) -> ScannedFunctions:
    """The same, of poses with these covariates."""
    angle = angle_of_harmonics(candidate.functions(values))
    return Harmonics(here.value(angle), values) if angle is not None else PoseFunctions(functions_of(candidate, here, values))
