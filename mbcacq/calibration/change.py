"""What changed at a moment while a recording was made: the mount, the scanner, a joint's zero, an artefact's place or a ball.

A change of three times the noise hides in an estimated noise. So the noise is estimated once more beside the step that looks best, and the
step pays for what this noise is less probable without it.

What is too weak to be said may still have moved the result. So a covariance is an average over all changes, each with its posterior
probability: the second moment of the error about what is published (Bayesian model averaging; Hoeting et al. 1999).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.change_found import ChangeFound
from mbcacq.estimation import terms
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.linear_problem import ExtendedProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import HAND_EYE
from mbcacq.estimation.pose_information import WeightedRows
from mbcacq.estimation.solution import Solution
from mbcacq.estimation.step_test import Steps, StepTest
from mbcacq.estimation.variance_components import log_restricted_posterior, restricted_maximum_likelihood
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER

# When a change is said. benchmarks/strikes.md has the rates of false and of missed ones.
FALSE_ALARMS = 0.01  # of recordings in which nothing changed
PROBABILITY_OF_CHANGE = 0.1  # probability that something changes while a recording is made
SUSPECTED = -2.0  # log e-value under the noise of no change, from which the noise beside the step is estimated
NOTABLE = 0.05  # probability of a change
NEGLIGIBLE = 1e-4  # part of the probability of all changes, below which a moment is left out of the average
REJECTED_OF_BALL = 0.1  # share of a ball's centres: no noise rejects so many, so they are looked at again
LEAST_SIDE = 3  # poses on either side of a moment
MOST_POSES = 4000  # whose columns fit into memory
SAME_MOMENT = 3.0  # of the log Bayes factor: moments that are this near are said as a range
OTHER_KIND = 3.0  # of the same: kinds that are this near are said too
TURNS = 3  # of noise and best step
WARMING = (1.0, 0.3, 0.1)  # of the duration of a recording, time constants with which a drift settles; the first is nearly a straight line


@dataclass(frozen=True)
class KindOfChange:
    """A kind of change. columns: (M, R, k). among: (P + 1,) bool of the moments. weight: prior probability of the kind."""

    name: str
    where: str
    components: tuple[str, ...]
    units: tuple[str, ...]
    columns: np.ndarray
    among: np.ndarray
    weight: float


@dataclass(frozen=True)
class ChangeEvidence:
    """What a recording says of changes, found or not.

    Attributes
    ----------
    log_e : float
        Logarithm of the e-value of all changes, -inf where none was looked for.
    found : ChangeFound or None
        The change; None if what the recording shows has a probability of ``false_alarms`` without one.
    second_moment : (g, g) ndarray or None
        Second moment of the errors of an estimate that ignores a change: averaged over kinds, moments and sizes.
    """

    log_e: float = -np.inf
    found: ChangeFound | None = None
    second_moment: np.ndarray | None = None

    @property
    def probability(self) -> float:
        """Posterior probability that something changed."""
        odds = np.exp(min(self.log_e, 500.0)) * PROBABILITY_OF_CHANGE / (1 - PROBABILITY_OF_CHANGE)
        return float(odds / (1 + odds))


def evidence_of_change(fitted: Adjustment) -> ChangeEvidence:
    """The evidence of a change in a recording.

    Parameters
    ----------
    fitted : Adjustment
        Adjustment of the recording, with random effects where it has some.
    """
    obs = fitted.lineariser.obs
    if obs.n_poses > MOST_POSES or obs.n_poses < 2 * LEAST_SIDE:
        return ChangeEvidence()
    at = _with_rejected_again(fitted.solution.evaluated())
    kinds = list(kinds_of_change(at))
    look = _look(at, kinds)
    log_e = look.log_e
    if log_e > SUSPECTED:
        before, noise = _log_posterior(at, at.noise), at.noise
        for _ in range(TURNS):
            noise = _noise_beside(at, kinds[look.kind], look.moment, noise)
            last, look = look, _look(at.reweighted(noise, at.weights), kinds)
            if (look.kind, look.moment) == (last.kind, last.moment):
                break
        log_e = look.log_e + _log_posterior(at, noise) - before
    found = _described(look, kinds, log_e) if log_e > -np.log(FALSE_ALARMS) and not _is_drift(look, kinds) else None
    return ChangeEvidence(log_e, found, _second_moment(look, kinds))


def _with_rejected_again(at: Solution) -> Solution:
    """With the centres of balls of which many are rejected, and with poses that are rejected one after the other: a ball that moved by much
    is rejected from then on, and after a large accident so is what is left of the recording, be it two poses. Two poses after which all is
    as before are gross errors, each by itself: they do not make a step."""
    obs, weights = at.lineariser.obs, at.weights
    count, n = (np.bincount(obs.ball, w, minlength=len(obs.cell.ball_ids)) for w in (weights.centre == 0, None))
    often = (count > REJECTED_OF_BALL * n) & (n - count >= LEAST_SIDE)
    in_a_row = np.zeros(obs.n_poses, bool)
    rejected = np.pad(weights.pose[obs.measuring_order] == 0, 1, constant_values=True)
    begins = np.convolve(rejected, np.ones(LEAST_SIDE), "valid") == LEAST_SIDE
    in_a_row[obs.measuring_order] = np.convolve(begins, np.ones(LEAST_SIDE))[1:-1] > 0
    if not (often.any() or in_a_row.any()):
        return at
    centre, pose = np.where(often[obs.ball], 1.0, weights.centre), np.where(in_a_row, 1.0, weights.pose)
    return at.reweighted(at.noise, replace(weights, centre=centre, pose=pose))


def kinds_of_change(at: Solution) -> Iterator[KindOfChange]:
    """Every kind of change that a recording may show."""
    obs, prediction = at.lineariser.obs, at.there.prediction
    moment, n, names = np.arange(obs.n_poses + 1), obs.cell.robot.n, ("x", "y", "z")
    every = (moment >= LEAST_SIDE) & (moment <= obs.n_poses - LEAST_SIDE)

    def unit(place: str, index: int, components: int) -> np.ndarray:
        return np.stack([terms.unit(obs, prediction, place, index, c) for c in range(components)], axis=2)

    twist, units = (*names, "rx", "ry", "rz"), ("mm",) * 3 + ("rad",) * 3
    yield KindOfChange("mount", "", twist, units, unit("frame", n, 6), every, 0.15)
    if obs.cell.measurement == ARTEFACT_IN_SCANNER:
        shift = unit("point", 0, 3)
        yield KindOfChange("scanner", "", names, units[:3], shift, every, 0.06)
        for c in range(3):
            yield KindOfChange("scanner", "", names[c : c + 1], units[:1], shift[..., c : c + 1], every, 0.03)
        scale = np.zeros((*shift.shape[:2], 1))
        scale[:, :3, 0] = 1e-6 * obs.xyz
        yield KindOfChange("scale", "", ("scale",), ("ppm",), scale, every, 0.05)
    for j in range(n):
        yield KindOfChange("joint", obs.cell.robot.tags[j], (obs.cell.robot.axes[j],), ("rad",), unit("joint", j, 1), every, 0.25 / n)
    station = unit("station", 0, 6)
    order = obs.station[obs.measuring_order]
    for s in np.unique(obs.station):
        here = np.flatnonzero(order == s)
        among = np.zeros(obs.n_poses + 1, bool)
        among[here[LEAST_SIDE : len(here) - LEAST_SIDE + 1]] = True
        at_s = station * (obs.station[obs.pose] == s)[:, None, None]
        yield KindOfChange("station", obs.cell.stations[s].id, twist, units, at_s, among, 0.25 / len(obs.cell.stations))
    if at.lineariser.rows.depth > 3:
        ball, count = unit("ball", 0, 3), len(obs.cell.ball_ids)
        for k, name in enumerate(map(str, obs.cell.ball_ids)):
            yield KindOfChange("ball", name, names, units[:3], ball * (obs.ball == k)[:, None, None], every, 0.15 / count)


@dataclass(frozen=True)
class _Look:
    """The steps of every kind under one noise. kind, moment: of the most probable one. log_bf: by kind, (P + 1,) with prior."""

    test: StepTest
    steps: list[Steps]
    log_bf: list[np.ndarray]
    kind: int
    moment: int
    log_e: float


def _look(at: Solution, kinds: list[KindOfChange]) -> _Look:
    test, steps, log_bf = StepTest(at), [], []
    for kind in kinds:
        found = test.of(kind.columns)
        prior = np.where(kind.among, np.log(kind.weight) - np.log(max(int(kind.among.sum()), 1)), -np.inf)
        steps.append(found)
        log_bf.append(found.log_bayes_factor + prior)
    best = [float(one.max()) for one in log_bf]
    k = int(np.argmax(best))
    return _Look(test, steps, log_bf, k, int(np.argmax(log_bf[k])), float(np.logaddexp.reduce(np.concatenate(log_bf))))


def _is_drift(look: _Look, kinds: list[KindOfChange]) -> bool:
    """Whether what looks like a step is more probable as a drift of the same kind, which settles in the course of the recording."""
    kind, obs = kinds[look.kind], look.test.solution.lineariser.obs
    clock = np.argsort(obs.measuring_order).astype(float) if obs.time_s is None else obs.time_s - obs.time_s.min()
    drifts = [1 - np.exp(-clock / (tau * clock.max())) for tau in WARMING]
    log_bf = [look.test.of(kind.columns * drift[obs.pose][:, None, None]).log_bayes_factor[0] for drift in drifts]
    return bool(np.logaddexp.reduce(log_bf) + np.log(kind.weight / len(WARMING)) > np.logaddexp.reduce(look.log_bf[look.kind]))


def _noise_beside(at: Solution, kind: KindOfChange, moment: int, start: Noise) -> Noise:
    """Most probable noise of the problem with a step of free size."""
    obs, rows = at.lineariser.obs, at.lineariser.rows
    after = np.zeros(obs.n_poses, bool)
    after[obs.measuring_order[moment:]] = True
    step = rows.pad(at.lineariser.weighted(kind.columns * after[obs.pose][:, None, None]))
    columns, k = at.columns.with_parameters(step), step.shape[2]
    sigma = np.concatenate([at.prior.sigma, 1e3 * np.where(np.array(kind.units) == "rad", 1e-2, 1.0)])
    prior = replace(at.prior, sigma=sigma, offset=np.concatenate([at.prior.offset, np.zeros(k)]))
    problem = ExtendedProblem(columns, WeightedRows(rows, columns, at.weights.centre, at.weights.pose), prior)
    return restricted_maximum_likelihood(lambda noise: problem.at(noise).after_fit(), start, at.lineariser.noise_prior)


def _log_posterior(at: Solution, noise: Noise) -> float:
    system = at.reweighted(noise, at.weights).system
    normal = system.normal
    fitted = replace(system, normal=normal.after(np.linalg.solve(normal.information, normal.gradient)))
    return log_restricted_posterior(fitted, noise, at.lineariser.noise_prior)


def _second_moment(look: _Look, kinds: list[KindOfChange]) -> np.ndarray:
    """(g, g) of the errors that the estimate has if one of the changes happened; the mount's before and after it are as likely."""
    test = look.test
    total = np.zeros_like(test.covariance)
    for kind, steps, log_bf in zip(kinds, look.steps, look.log_bf, strict=True):
        t = np.flatnonzero(log_bf > look.log_e + np.log(NEGLIGIBLE))
        share, root, (mean, square) = np.exp(log_bf[t] - look.log_e), steps.root[t], steps.shrinkage(t)
        value = np.einsum("tkl,tml,tm->tk", root, root, steps.right[t])
        absorbed = test.covariance @ np.swapaxes(steps.with_parameters[t], 1, 2)
        mounted = _after_mount(test.solution, kind)
        states = (absorbed,) if mounted is None else (absorbed, absorbed - mounted)
        for G in states:
            w, off, spread = share / len(states), (G @ value[..., None])[..., 0], G @ root
            cross = np.outer(test.step, (w * mean) @ off)
            total += w.sum() * np.outer(test.step, test.step) - cross - cross.T
            total += (off * (w * square)[:, None]).T @ off + np.einsum("t,tgk,thk->gh", w * mean, spread, spread, optimize=True)
    return total


def _after_mount(at: Solution, kind: KindOfChange) -> np.ndarray | None:
    """(g, k) twist of the hand-eye, in the scanner frame, by a step of the mount or the scanner; None for other kinds."""
    if kind.name not in ("mount", "scanner"):
        return None
    T = at.estimate.state.T_flange_scanner
    shift = np.eye(6)[:, ["xyz".index(c) for c in kind.components]] if kind.name == "scanner" else np.zeros((6, 0))
    twist = -shift if kind.name == "scanner" else se3.adjoint(se3.inverse(T if T.ndim == 2 else T[0]))
    names, out = at.lineariser.layout.names, np.zeros((at.normal.size, twist.shape[1]))
    for row, c in zip(twist, HAND_EYE, strict=True):
        if f"hand_eye.{c}" in names:
            out[names.index(f"hand_eye.{c}")] = row
    return out


def _described(look: _Look, kinds: list[KindOfChange], log_e: float) -> ChangeFound:
    kind, test, t = kinds[look.kind], look.test, look.moment
    obs, of = test.solution.lineariser.obs, look.log_bf[look.kind]
    near = _with_every_pose(test.solution, kind, np.flatnonzero(of > of[t] - SAME_MOMENT))
    t = t if t in near else int(near[0])
    value, covariance = look.steps[look.kind].estimate(t)
    best: dict[str, float] = {}
    for one, log_bf in zip(kinds, look.log_bf, strict=True):
        name = f"{one.name}:{one.where}"
        best[name] = max(best.get(name, -np.inf), float(np.logaddexp.reduce(log_bf)))
    own = f"{kind.name}:{kind.where}"
    other = tuple(name for name, size in best.items() if name != own and size > best[own] - OTHER_KIND)
    other = () if kind.name in ("mount", "scanner") and set(other) <= {"mount:", "scanner:"} else other
    pose = int(test.order[t])
    before, after, std = _hand_eyes(look, kind, value, covariance)
    return ChangeFound(
        kind=kind.name,
        where=kind.where,
        before=int(obs.pose_id[test.order[near.min() - 1]]),
        after=int(obs.pose_id[test.order[near.max()]]),
        nth=t + 1,
        poses=obs.n_poses,
        station=obs.cell.stations[obs.station[pose]].id,
        seconds=None if obs.time_s is None else float(obs.time_s[pose] - obs.time_s.min()),
        components=kind.components,
        units=kind.units,
        value=tuple(value.tolist()),
        std=tuple(np.sqrt(np.diag(covariance)).tolist()),
        log_e=log_e,
        or_else=other,
        hand_eye_before=tuple(map(tuple, before.tolist())),
        hand_eye_after=tuple(map(tuple, after.tolist())),
        hand_eye_std=tuple(std.tolist()),
    )


def _with_every_pose(at: Solution, kind: KindOfChange, near: np.ndarray) -> np.ndarray:
    """The moments among these that poses which were rejected leave: an accident is followed by outliers."""
    every = at.reweighted(at.noise, replace(at.weights, pose=np.ones_like(at.weights.pose)))
    gain = StepTest(every).of(kind.columns).gain[near]
    return near[gain > gain.max() - 2 * SAME_MOMENT]


def _hand_eyes(look: _Look, kind: KindOfChange, value: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """T_flange_scanner before and after a step, by the linear problem with it; and (6,) standard deviations before."""
    test, at = look.test, look.test.solution
    names = at.lineariser.layout.names
    index = [names.index(f"hand_eye.{c}") if f"hand_eye.{c}" in names else -1 for c in HAND_EYE]
    absorbed = test.covariance @ look.steps[look.kind].with_parameters[look.moment].T
    moved, C = test.step - absorbed @ value, test.covariance + absorbed @ covariance @ absorbed.T
    twist = np.array([moved[i] if i >= 0 else 0.0 for i in index])
    std = np.array([np.sqrt(C[i, i]) if i >= 0 else 0.0 for i in index])
    T = at.estimate.state.T_flange_scanner
    before = (T if T.ndim == 2 else T[0]) @ se3.exp(twist)
    if kind.name == "mount":
        return before, se3.exp(value) @ before, std
    if kind.name == "scanner":
        shift = np.zeros(3)
        shift[["xyz".index(c) for c in kind.components]] = value
        return before, before @ se3.exp(np.concatenate([-shift, np.zeros(3)])), std
    return before, before, std
