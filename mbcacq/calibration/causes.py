"""What simple fault explains a recording that contradicts its description: found by cheap tests, each of which has one story.

Balls taken for each other show in distances alone. A wrong sign, unit, order or frame removes most of the misfit when it is mended. A place
that moved, a scanner that slipped or a joint that stepped at a moment, one wrong pose and one wrong ball are further columns of the linear
problem. Their gain of chi square follows from the solution without another fit.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.change import in_words, kinds_of_change
from mbcacq.calibration.influence import deletions
from mbcacq.description import plain_fit, wrong_descriptions
from mbcacq.estimation.solution import Solution
from mbcacq.estimation.step_test import StepTest
from mbcacq.model import shipped
from mbcacq.model.observations import Observations

EXPLAINED = 0.7  # share of the misfit beyond the noise that a story must remove to be said
SCATTER = 6.0  # standard deviations of chi square, within which a misfit needs no story
APART = 20.0  # of chi square to the best story of another kind: odds of e^10; a wrong name is worse than none
SAME = 20.0  # of chi square: moments that are this near are said as a range
MOST_POSES = 400  # whose moments are looked at
OTHER_ARM = 0.2  # of the misfit that another arm must leave at most
NEAR_BALLS = 5.0  # times noise and uncertainty of the certificate: how well distances between balls must agree
MOST_TRIED = 20_000  # assignments of a ball; eight balls take a hundred


@dataclass(frozen=True)
class Story:
    """A simple fault while the recording was made.

    Attributes
    ----------
    kind : str
        Kind of fault; the best one of each kind is kept.
    gain : float
        Fall of chi square.
    freedom : float
        Parameters it takes, and what the choice of its moment or pose is worth.
    pose : int or None
        Number of the pose that it is about, None where it is about no single one.
    """

    kind: str
    text: str
    gain: float
    freedom: float
    pose: int | None = None

    @property
    def net(self) -> float:
        return self.gain - self.freedom


def fault_of(strict: Solution, known: Collection[int] = ()) -> str:
    """A sentence on the one simple fault while the recording was made that explains it. It is '' if none does, if the misfit is within the
    scatter of the noise, or if one of the ``known`` poses (their numbers) explains it.

    Parameters
    ----------
    strict : Solution
        The recording, every pose with full weight, solved under the noise that statement and data sheet allow.
    known : Collection[int]
        Poses that were rejected already.
    """
    misfit = beyond_noise(strict, strict.cost)
    best = convincing(list(stories(strict)), misfit) if misfit else None
    return "" if best is None or best.pose in known else best.text


def misdescribed(obs: Observations) -> str:
    """A sentence on what is described otherwise than it was measured: numbers of balls, signs, units, orders and frames, the arm; '' where
    no simple change of the description removes most of the misfit."""
    return exchanged_balls(obs) or "; ".join(map(str, wrong_descriptions(obs))) or other_arm(obs)


def beyond_noise(at: Solution, chi2: float) -> float:
    """How much of a chi square with the weights of a solution the noise does not explain; 0 where it is within its scatter."""
    weights = at.weights.centre * at.weights.pose[at.lineariser.obs.pose]
    flat = int(np.sum(~np.isfinite(at.prior.sigma))) + int(at.normal.station_rank.sum())
    dof = max(at.lineariser.rows.width * float(weights.sum()) - flat, 1.0)
    return chi2 - dof if chi2 - dof > SCATTER * np.sqrt(2 * dof) else 0.0


def convincing(found: list[Story], misfit: float) -> Story | None:
    """The best story where it explains enough and no story of another kind comes near."""
    if not found:
        return None
    ranked = sorted(found, key=lambda s: -s.net)
    best = ranked[0]
    others = [s for s in ranked if s.kind != best.kind]
    if best.gain < EXPLAINED * misfit or (others and others[0].net > best.net - APART):
        return None
    return best


def stories(strict: Solution) -> Iterator[Story]:
    """The best of each kind."""
    obs = strict.lineariser.obs
    if obs.n_poses <= MOST_POSES:
        yield from _moments(strict)
    deleted = deletions(strict, np.zeros(0, dtype=int))
    pose = int(np.argmax(deleted.chi2 - deleted.rank))
    number = int(obs.pose_id[pose])
    text = f"pose {number} alone explains it; measure it again before it is left out"
    price = float(deleted.rank[pose]) + 2 * np.log(obs.n_poses)
    yield Story("pose", text, float(deleted.chi2[pose]), price, number)


def _moments(strict: Solution) -> Iterator[Story]:
    """The best moment of each kind of change that has a story."""
    test, obs = StepTest(strict), strict.lineariser.obs
    for kind in kinds_of_change(strict):
        among = np.flatnonzero(kind.among)
        if kind.name not in ("station", "mount", "joint") or not len(among):
            continue
        gains = test.of(kind.columns).gain
        best = among[int(np.argmax(gains[among]))]
        near = among[gains[among] > gains[best] - SAME]
        before, after = (int(obs.pose_id[test.order[t]]) for t in (near.min() - 1, near.max()))
        what, to_do = in_words(kind.name, kind.where)
        price = kind.columns.shape[2] + 2 * float(np.log(obs.n_poses))
        yield Story(kind.name, f"{what} between pose {before} and pose {after}; {to_do}", float(gains[best]), price)


def exchanged_balls(obs: Observations) -> str:
    """A sentence on balls whose numbers are exchanged, by the distances between the balls of each scan; '' where the numbers agree with
    them, or no exchange makes them agree."""
    measured = _mean_distances(obs)
    if measured is None:
        return ""
    certified = np.linalg.norm(obs.cell.ball_centres[:, None] - obs.cell.ball_centres[None], axis=2)
    noise = 0.02 if obs.cell.noise_mm is None else float(np.mean(obs.cell.noise_mm))
    agree = NEAR_BALLS * (noise + max(a.uncertainty_mm for a in obs.cell.artefacts))
    if not np.nanmax(np.abs(measured - certified)) > agree:
        return ""
    order = _matched(measured, certified, obs.cell.ball_artefact, agree)
    if order is None:
        return ""
    ids = obs.cell.ball_ids
    pairs = ", ".join(f"{ids[k]} is certified as {ids[as_]}" for k, as_ in enumerate(order) if as_ != k)
    return f"the numbers of balls are exchanged (by the distances between them, {pairs}); correct the certificate or the numbers"


def _matched(measured: np.ndarray, certified: np.ndarray, artefact: np.ndarray, agree: float) -> list[int] | None:
    """Which certified ball of its artefact each measured one is, so that all distances (K, K) agree within ``agree`` mm; None where there
    is no such assignment. Ball after ball is assigned, and taken back where a distance to the balls before it does not fit."""
    order: list[int] = []
    choices = [iter(np.flatnonzero(artefact == artefact[0]))]
    for _ in range(MOST_TRIED):
        k = len(order)
        if k == len(measured):
            return order
        chosen = next((int(c) for c in choices[-1] if c not in order and _fits(measured[k, :k], certified[c, order], agree)), None)
        if chosen is not None:
            order.append(chosen)
            choices.append(iter(np.flatnonzero(artefact == artefact[min(k + 1, len(measured) - 1)])))
        elif order:
            order.pop()
            choices.pop()
        else:
            return None
    return None


def _fits(measured: np.ndarray, certified: np.ndarray, agree: float) -> bool:
    """Whether the distances that were measured agree; NaN stands for one that was not."""
    return not np.any(np.abs(measured - certified) > agree)


def _mean_distances(obs: Observations) -> np.ndarray | None:
    """(K, K) mm mean distance of two balls over the scans that show both, NaN where none does; None of one ball a scan."""
    K = len(obs.cell.ball_ids)
    where = np.full((obs.n_poses, K, 3), np.nan)
    where[obs.pose, obs.ball] = obs.xyz
    apart = np.linalg.norm(where[:, :, None] - where[:, None], axis=3)
    seen = np.isfinite(apart)
    seen[:, np.arange(K), np.arange(K)] = False
    count = seen.sum(axis=0)
    if not count.any():
        return None
    return np.where(count > 0, np.where(seen, apart, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def other_arm(obs: Observations) -> str:
    """A sentence on an arm of the tool's own that fits much better than the one that is named; '' where none does."""
    few = plain_fit.subset(obs)
    before = plain_fit.residual_mm(few)
    found = []
    for name in shipped.robots():
        robot = shipped.robot(name)
        if robot.n == obs.cell.robot.n and robot.name != obs.cell.robot.name:
            tried = replace(few, cell=replace(few.cell, robot=replace(few.cell.robot, chain=robot.chain)))
            found.append((plain_fit.residual_mm(tried), robot.name))
    if not found or min(found)[0] > OTHER_ARM * before:
        return ""
    left, name = min(found)
    return (
        f"with the links of {name} in place of {obs.cell.robot.name} the residual falls from {before:.3g} to {left:.3g} mm; name that arm"
    )
