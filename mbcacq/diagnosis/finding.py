"""One pass from observations to a model: fit geometry, estimate noise, let named effects compete, model the rest, examine what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from mbcacq.calibration.terms import accumulate, term
from mbcacq.diagnosis import base_fit, noise, residual_test, smooth
from mbcacq.diagnosis.explain import COMPANIONS, FALSE_ALARM, NOTHING, Model, Search
from mbcacq.diagnosis.linear import Linear
from mbcacq.diagnosis.locate import Spot
from mbcacq.diagnosis.residual_test import Leftover
from mbcacq.diagnosis.screen import LARGEST, Screen, prior_weight
from mbcacq.diagnosis.smooth import SmoothModel
from mbcacq.diagnosis.whitening import Noise
from mbcacq.observations import Observations
from mbcacq.physics import catalogue
from mbcacq.physics.effect import Candidate
from mbcacq.physics.situation import Situation

PASSES = 4
SEARCHED = 800  # poses that the search for names looks at, of a long recording


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

    before, named: screens (geometry only; named effects too) under that noise. leftover: examination of what named effects leave.
    rival: a single smooth dependence that explains more, for what it costs, than several named effects together.
    """

    model: Model
    smooth: SmoothModel | None
    noise: Noise
    before: Screen
    named: Screen
    leftover: Leftover | None
    rival: Spot | None = None


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


def outliers(screen: Screen, members: Model) -> np.ndarray:
    """(M,) bool of the centres worth keeping, judged with the model in place: within seven sigma of instrument and joint noise."""
    linear = screen.linear
    columns, sigma = columns_of(linear, members, None)
    Z = screen.whiten(columns) * sigma
    normal = Z.T @ Z
    left = linear.residual - columns @ (sigma * np.linalg.solve(normal + np.eye(len(sigma)), Z.T @ screen.r0))
    J = linear.joint * screen.noise.joint
    S = J @ np.swapaxes(J, 1, 2)
    S[:, np.arange(linear.width), np.arange(linear.width)] += screen.noise.rows(linear.width) ** 2
    square = np.einsum("mr,mr->m", left, np.linalg.solve(S, left[:, :, None])[:, :, 0])
    typical = max(float(np.median(square[linear.keep])) / chi2.median(linear.width), 1.0)
    return square < typical * chi2.isf(1e-7, linear.width)


def thin(setup: Setup, keep: np.ndarray, most: int) -> Setup:
    """The same recording with at most ``most`` of the poses that have a kept centre, evenly at random along its order."""
    obs = setup.linear.obs
    has = np.flatnonzero(np.bincount(obs.pose[keep], minlength=obs.n_poses) > 0)
    rng = np.random.default_rng(0)
    chosen = np.zeros(obs.n_poses, bool)
    chosen[[rng.choice(part) for part in np.array_split(has[np.argsort(setup.situation.order[has])], min(most, len(has)))]] = True
    small = obs.select(chosen)
    linear = Linear(small, setup.linear.state, keep[chosen[obs.pose]])
    situation = Situation(small, setup.linear.state, linear.prediction)
    return Setup(linear, situation, catalogue.candidates(situation)[0], setup.dropped, setup.first)


def back(setup: Setup, small: Setup, model: Model) -> Model:
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
    return Model(tuple(members), 0.0, 0.0, np.zeros(0), np.zeros((0, 0)))


def settle(linear: Linear, model: Model, sigma: Noise) -> Linear:
    """Linearised anew with the model in place: what a fit without it bent out of shape no longer bends its derivatives."""
    if not model.members:
        return linear
    columns, width = columns_of(linear, model, None)
    Z = linear.whitener(sigma)
    scaled = Z(columns) * width
    normal = scaled.T @ scaled
    solution = width * np.linalg.solve(normal + np.eye(len(width)), scaled.T @ Z(linear.residual))
    _, _, layout = linear.nuisance()
    terms = [term(c.name, c.build(h)) for c, h in model.members]
    ends = layout.size + np.cumsum([0] + [c.k for c, _ in model.members])
    values = [solution[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    new = Linear(linear.obs, linear.moved(solution[: layout.size], layout), linear.keep, accumulate(linear.obs, terms, values))
    for one, value in zip(terms, values, strict=True):
        new.residual = new.residual + new.columns(list(one.parts)) @ value
    return new


def search_named(setup: Setup, linear: Linear, settling: bool = True, first: Noise | None = None) -> tuple[Model, Noise, Search, Linear]:
    """Named effects, noise and linearisation in turns, until the set of effects stands still."""
    large = linear.obs.n_poses > smooth.MANY_POSES
    search = Search(
        setup.candidates,
        beam=1 if large else 3,
        branches=3 if large else 6,
        most=5 if large else 10,
        thorough=not large,
        least_share=0.003 if large else 0.0,
        situation=None if large else setup.situation,
    )
    sigma = noise.estimate(linear, *columns_of(linear, NOTHING, None), setup.first if first is None else first, setup.first)
    model = NOTHING
    for turn in range(2 if large or not settling else PASSES):
        screen = Screen(linear, sigma)
        start = NOTHING
        if large:  # every arm is elastic: what elasticity explains is not given to slow periodic errors
            elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
            start = Search(elastic, beam=1, branches=2, most=6).run(screen) if turn == 0 else model
            if turn == 0:
                search = replace(search, protected=frozenset(c.key for c, _ in start.members))
        new = search.run(screen, start=start)
        same = {c.key for c, _ in new.members} == {c.key for c, _ in model.members}
        model = new
        if not model.members:
            break
        sigma = noise.estimate(linear, *columns_of(linear, model, None), sigma, setup.first)
        for _ in range(2 * settling):
            linear = settle(linear, model, sigma)
        if same:
            break
    return model, sigma, search, linear


def find(setup: Setup, keep: np.ndarray | None = None, examine: bool = True, structure: bool | None = None, again: bool = True) -> Finding:
    """The model of the centres in keep; without keep, outliers are reconsidered once with the model in place.

    structure: whether to fit smooth groups; None lets the examination decide.
    """
    linear = setup.linear if keep is None else setup.linear.restricted(keep)
    large = linear.obs.n_poses > smooth.MANY_POSES
    small = thin(setup, linear.keep, SEARCHED) if large else setup
    model, sigma, search, settled = search_named(small, small.linear if large else linear, settling=keep is None)
    if not large:
        linear = settled
    if large:
        model = back(setup, small, model)
        linear = settle(linear, model, sigma)
        sigma = noise.estimate(linear, *columns_of(linear, model, None), sigma, setup.first)
        search = Search(setup.candidates, thorough=False)
    before = Screen(linear, sigma)
    model = search.solve(before, model.members, permit=True)
    if keep is None and again:
        better = outliers(before, model)
        if not np.array_equal(better, linear.keep) and np.mean(~better) < 0.05:
            return find(replace(setup, linear=linear.restricted(better)), None, examine, structure, again=False)
    named = with_members(before, model)
    leftover = None
    if examine and large:
        small_named = with_members(Screen(small.linear, sigma), back(small, setup, model))
        leftover = residual_test.examine(small_named, small.situation)
    elif examine:
        leftover = residual_test.examine(named, setup.situation)
    rest, rival = None, None
    if examine and not large and len(model.members) > 1:
        rival = single_cause(before, model, setup.situation)
    if rival is not None:
        model, named = NOTHING, before
        leftover = residual_test.examine(before, setup.situation)
    if structure or (structure is None and leftover is not None and leftover.structure):
        groups = (
            smooth.everything(linear, setup.situation)
            if large
            else smooth.located(linear, setup.situation, leftover_spots(named, setup, leftover))
        )
        sizes = None
        for _ in range(2):
            new = smooth.fit(named, groups, sizes)
            if new is None:
                break
            rest, groups, sizes = new, new.groups, new.sizes
            sigma = noise_beside(linear, model, rest, sigma, setup.first)
            before = Screen(linear, sigma)
            named = with_members(before, model)
        if rest is not None:
            rest = smooth.fit(named, groups, sizes) or rest
            model = search.solve(before, model.members, permit=True)
    return Finding(model, rest, sigma, before, named, leftover, rival)


def single_cause(before: Screen, model: Model, s: Situation) -> Spot | None:
    """The one place and covariate whose smooth function beats a string of names, or None."""
    if len(model.names) == 1 and model.names[0] in COMPANIONS:
        return None
    spots = residual_test.mismatch(before, s)
    value = [p.gain - chi2.isf(FALSE_ALARM / len(spots), p.k) for p in spots]
    best = int(np.argmax(value))
    return spots[best] if value[best] > model.score else None


def noise_beside(linear: Linear, model: Model, rest: SmoothModel, start: Noise, prior: Noise) -> Noise:
    """Noise of what smooth groups leave, counting the coefficients they used."""
    less = linear.restricted(linear.keep)
    less.residual = linear.residual - rest.columns @ rest.coefficients
    sigma = noise.estimate(less, *columns_of(less, model, None), start, prior)
    rows = float(linear.keep.sum() * linear.width)
    grow = np.sqrt(rows / max(rows - rest.used, 0.3 * rows))
    return Noise(sigma.point * grow, sigma.joint * grow, sigma.turn * grow)


def leftover_spots(named: Screen, setup: Setup, leftover: Leftover | None):
    found = leftover if leftover is not None else residual_test.examine(named, setup.situation)
    return found.significant or found.spots[:1]


def with_members(screen: Screen, model: Model) -> Screen:
    return screen.adopted([(screen.block(c, h), prior_weight(c)) for c, h in model.members])
