"""The recording made ready: geometry fitted, linearised there, and everything that may compete; long recordings thinned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.linearized import geometry_fit
from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.linearized.whitening import NoiseEstimate
from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.search.detectability import sighted
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class DiagnosisProblem:
    """The recording linearised at its geometric fit, and everything that may compete."""

    linear: LinearProblem
    situation: Context
    candidates: list[Candidate]
    dropped: dict[str, str]
    first: NoiseEstimate

    @cached_property
    def chart(self) -> DesignBlocks:
        """Of what has no name: places by shapes."""
        return DesignBlocks(self.situation)

    def at(self, linear: LinearProblem) -> DiagnosisProblem:
        """The same with another linearisation, or other centres kept; the chart is of the poses, and stays."""
        out = replace(self, linear=linear)
        out.__dict__["chart"] = self.chart
        return out


def prepare(obs: Observations) -> DiagnosisProblem:
    first = geometry_fit.first_noise(obs)
    state, keep = geometry_fit.fit(obs, first)
    linear = LinearProblem(obs, state, keep)
    situation = Context(obs, state, linear.prediction)
    candidates, dropped = catalogue.candidates(situation)
    return DiagnosisProblem(linear, situation, sighted(linear, first, candidates), dropped, first)


def thin(setup: DiagnosisProblem, keep: np.ndarray, most: int) -> DiagnosisProblem:
    """The same recording with at most ``most`` of the poses that have a kept centre, evenly at random along its order."""
    obs = setup.linear.obs
    has = np.flatnonzero(np.bincount(obs.pose[keep], minlength=obs.n_poses) > 0)
    rng = np.random.default_rng(0)
    chosen = np.zeros(obs.n_poses, bool)
    chosen[[rng.choice(part) for part in np.array_split(has[np.argsort(setup.situation.order[has])], min(most, len(has)))]] = True
    small = obs.select(chosen)
    linear = LinearProblem(small, setup.linear.state, keep[chosen[obs.pose]])
    situation = Context(small, setup.linear.state, linear.prediction)
    return DiagnosisProblem(linear, situation, catalogue.candidates(situation)[0], setup.dropped, setup.first)


def back(setup: DiagnosisProblem, small: DiagnosisProblem, model: EffectSet) -> EffectSet:
    """The members of a model found on a thinned recording, as candidates of the whole one."""
    by_key = {c.key: c for c in setup.candidates}
    members = []
    for candidate, hyper in model.members:
        if candidate.hyper is not None and candidate.hyper.name == "at_pose":
            pose = small.linear.obs.pose_id[np.flatnonzero(small.situation.order == int(hyper))[0]]
            later = setup.linear.obs.pose_id[np.argsort(setup.situation.order)]
            hyper = (
                float(np.flatnonzero(later == pose)[0]) if np.any(later == pose) else float(hyper) * len(later) / small.linear.obs.n_poses
            )
        if candidate.key in by_key:
            members.append((by_key[candidate.key], hyper))
    return EffectSet(tuple(members))
