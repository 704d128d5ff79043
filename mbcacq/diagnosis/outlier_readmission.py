"""Centres set aside before anything was known, offered to the effects once: many of them, or whole poses, may be an effect themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.linearized import variance_components
from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.nonparametric.joint_model import columns_of, outliers
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NOTHING

MANY = 0.015  # share of the centres from which they are no longer taken for accidents unasked
WHOLE_POSES = 3  # as many poses without any centre left
TRIED, LEFT = 3, 0.5  # best candidates tried; share of the set aside that may remain so


def readmitted(setup: DiagnosisProblem) -> DiagnosisProblem:
    """The recording with those centres back that one candidate alone explains; as it was where none explains half of them."""
    linear = setup.linear
    aside = int(np.sum(~linear.keep))
    seen = np.bincount(linear.obs.pose, linear.keep, linear.obs.n_poses)
    if aside <= MANY * len(linear.keep) and int(np.sum(seen == 0)) < WHOLE_POSES:
        return setup
    sigma = variance_components.estimate(linear, *columns_of(linear, NOTHING, None), setup.first, setup.first)
    everything = LinearProblem(linear.obs, linear.state, np.ones(len(linear.keep), bool))
    screen, search = CandidateScoring(everything, sigma), BeamSearch([c for c in setup.candidates if not c.several])
    best, fewest = None, LEFT * aside
    for scored in search.expand(screen, NOTHING)[:TRIED]:
        model = search.solve(screen, ((scored.candidate, scored.hyper),))
        if model is None:
            continue
        keep = outliers(screen, model)
        if np.sum(~keep) < fewest:
            best, fewest = keep, np.sum(~keep)
    return setup if best is None else replace(setup, linear=everything.restricted(best))
