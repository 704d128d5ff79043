"""Outlier readmission: many centres rejected before anything was known, or whole poses, may be an effect themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import evidence_of_candidates
from mbcacq.diagnosis.nonparametric.joint_model import kept_centres, noise_with
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS, EffectSet

MANY = 0.015  # share of the centres from which rejected ones may be no accidents
WHOLE_POSES = 3  # or as many poses without any centre left
TRIED, STILL_REJECTED = 3, 0.5  # best candidates tried; share of the rejected centres that may remain so


def readmit_outliers(problem: DiagnosisProblem) -> DiagnosisProblem:
    """The recording with those rejected centres back that one candidate alone explains; as it was where none explains half of them."""
    linear = problem.linear
    rejected = int(np.sum(~linear.keep))
    left = np.bincount(linear.obs.pose, linear.keep, linear.obs.n_poses)
    if rejected <= MANY * len(linear.keep) and int(np.sum(left == 0)) < WHOLE_POSES:
        return problem
    noise = problem.noise
    everything = linear.restricted(np.ones(len(linear.keep), bool))
    projected = CandidateScoring.of(everything, noise)
    scored = evidence_of_candidates(projected, [c for c in problem.candidates if not c.several])
    best, fewest = None, STILL_REJECTED * rejected
    for one in sorted(scored, key=lambda s: -s.log_evidence)[:TRIED]:
        keep = kept_centres(projected, EffectSet(((one.candidate, one.hyper),)))
        if np.sum(~keep) < fewest:
            best, fewest = keep, np.sum(~keep)
    if best is None:
        return problem
    better = everything.restricted(best)
    return replace(problem, linear=better, noise=noise_with(better, NO_EFFECTS, noise, problem.prior_noise))
