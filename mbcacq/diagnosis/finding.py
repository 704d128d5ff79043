"""One pass from observations to a model: fit geometry, estimate noise, let named effects compete, model the rest, examine what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis import base_fit, noise, residual_test, smooth
from mbcacq.diagnosis.explain import NOTHING, Model, Search
from mbcacq.diagnosis.linear import Linear
from mbcacq.diagnosis.residual_test import Leftover
from mbcacq.diagnosis.screen import LARGEST, Screen, prior_weight
from mbcacq.diagnosis.smooth import SmoothModel
from mbcacq.diagnosis.whitening import Noise
from mbcacq.observations import Observations
from mbcacq.physics import catalogue
from mbcacq.physics.effect import Candidate
from mbcacq.physics.situation import Situation

PASSES = 4


@dataclass(frozen=True)
class Setup:
    """The recording linearised at its geometric fit, and everything that may compete."""

    linear: Linear
    situation: Situation
    candidates: list[Candidate]
    dropped: dict[str, str]
    first: Noise


@dataclass(frozen=True)
class Finding:
    """model: named effects; smooth: what has no name, or None. noise: estimated with both in place.

    before, after: screens (geometry only; everything) under that noise. leftover: examination of what named effects leave.
    """

    model: Model
    smooth: SmoothModel | None
    noise: Noise
    before: Screen
    named: Screen
    leftover: Leftover | None


def prepare(obs: Observations) -> Setup:
    first = base_fit.first_noise(obs)
    state, keep = base_fit.fit(obs, first)
    linear = Linear(obs, state, keep)
    situation = Situation(obs, state, linear.prediction)
    candidates, dropped = catalogue.candidates(situation)
    return Setup(linear, situation, candidates, dropped, first)


def columns_of(linear: Linear, model: Model, smooth_model: SmoothModel | None) -> tuple[np.ndarray, np.ndarray]:
    """Free geometry, named effects and smooth groups together: (M, R, z) and prior sigma (z,)."""
    columns, sigma, _ = linear.nuisance()
    blocks, widths = [columns], [sigma]
    for candidate, hyper in model.members:
        blocks.append(linear.columns(candidate.build(hyper)))
        widths.append(LARGEST * candidate.typical)
    if smooth_model is not None:
        blocks.append(smooth_model.columns)
        widths.append(smooth_model.sigma)
    return np.concatenate(blocks, axis=2), np.concatenate(widths)


def find(setup: Setup, keep: np.ndarray | None = None, examine: bool = True, structure: bool | None = None) -> Finding:
    """The model of the centres in keep. structure: whether to fit smooth groups; None lets the examination decide."""
    linear = setup.linear if keep is None else setup.linear.restricted(keep)
    large = linear.obs.n_poses > smooth.MANY_POSES
    search = Search(setup.candidates, beam=1 if large else 3, branches=3 if large else 6, most=10, thorough=not large)
    sigma = noise.estimate(linear, *columns_of(linear, NOTHING, None), setup.first, setup.first)
    model = NOTHING
    for _ in range(2 if large else PASSES):
        screen = Screen(linear, sigma)
        new = search.run(screen, start=model if large else NOTHING)
        same = {c.key for c, _ in new.members} == {c.key for c, _ in model.members}
        model = new
        if not model.members:
            break
        sigma = noise.estimate(linear, *columns_of(linear, model, None), sigma, setup.first)
        if same:
            break
    before = Screen(linear, sigma)
    model = search.solve(before, model.members) or model
    named = with_members(before, model)
    leftover = residual_test.examine(named, setup.situation) if examine else None
    rest = None
    if structure or (structure is None and leftover is not None and leftover.structure):
        groups = smooth.everything(linear, setup.situation) if large else smooth.located(linear, setup.situation, leftover_spots(named, setup, leftover))
        for _ in range(2):
            rest = smooth.fit(named, groups)
            if rest is None:
                break
            sigma = noise.estimate(linear, *columns_of(linear, model, rest), sigma, setup.first)
            before = Screen(linear, sigma)
            named = with_members(before, model)
        if rest is not None:
            rest = smooth.fit(named, groups) or rest
    return Finding(model, rest, sigma, before, named, leftover)


def leftover_spots(named: Screen, setup: Setup, leftover: Leftover | None):
    found = leftover if leftover is not None else residual_test.examine(named, setup.situation)
    return found.significant or found.spots[:1]


def with_members(screen: Screen, model: Model) -> Screen:
    return screen.adopted([(screen.block(c, h), prior_weight(c)) for c, h in model.members])
