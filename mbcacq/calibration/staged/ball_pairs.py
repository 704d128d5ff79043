"""Which pairs of measured centres enter the distance constraint (Eq. 21-24).

The equations speak of "the two points" a and b, "the center points of two spheres on the stereo target". About repetition they only say
that "the position of the stereo target was varied, and the above process was repeated": one pair of balls, at every position. That is
``one``. Nothing there takes four balls (they make the virtual point of Eq. 5) or all of them; read as an equation for *any* two balls it
would allow ``all``. Which two is not said: the two farthest apart are taken. Nor is said which poses: all pairs of poses of a position are
taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mbcacq.errors import CalibrationError
from mbcacq.model.observations import CENTRE_COLUMNS, Observations

LARGEST = 60_000
VIRTUAL_BALLS = 4
FLAT_MM = 1.0


@dataclass(frozen=True)
class PairDistances:
    """Pairs of measured centres. a, b: (K,) rows of the centres; certified: (K,) mm."""

    a: np.ndarray
    b: np.ndarray
    certified: np.ndarray


def pairs(pose: np.ndarray, station: np.ndarray, ball: np.ndarray, certified: np.ndarray, seed: int = 0) -> PairDistances:
    """All pairs of different balls seen from different poses of the same station; at most LARGEST, drawn evenly. Two balls of one scan
    say nothing: any rigid motion keeps their distance.

    pose, station, ball: (M,) of the centres; certified: (K, 3) centres, indexed by ``ball``.
    """
    a, b = [np.zeros(0, int)], [np.zeros(0, int)]
    for s in np.unique(station):
        rows = np.flatnonzero(station == s)
        i, j = np.triu_indices(len(rows), 1)
        keep = (pose[rows[i]] != pose[rows[j]]) & (ball[rows[i]] != ball[rows[j]])
        a.append(rows[i[keep]])
        b.append(rows[j[keep]])
    a, b = np.concatenate(a), np.concatenate(b)
    if len(a) > LARGEST:
        chosen = np.sort(np.random.default_rng(seed).choice(len(a), LARGEST, replace=False))
        a, b = a[chosen], b[chosen]
    return PairDistances(a, b, np.linalg.norm(certified[ball[a]] - certified[ball[b]], axis=1))


def several_balls(obs: Observations, how: str) -> Observations:
    """The recording with the balls that the method works on: four of each artefact, those seen most often, or (how = 'all') all of them.
    Artefacts with fewer than four are left out. Raises CalibrationError where no artefact shows four balls that are not on one line."""
    count = np.bincount(obs.ball, minlength=len(obs.cell.ball_ids))
    keep = np.zeros(len(count), bool)
    for a in range(len(obs.cell.artefacts)):
        own = np.flatnonzero((obs.cell.ball_artefact == a) & (count > 0))
        chosen = own if how == "all" else own[np.argsort(-count[own], kind="stable")[:VIRTUAL_BALLS]]
        if len(own) >= VIRTUAL_BALLS and width(obs.cell.ball_centres[chosen]) > FLAT_MM:
            keep[chosen] = True
    if not keep.any():
        raise CalibrationError(
            "the paper's method needs four balls of an artefact that are not on one line (for its virtual point and "
            "its angles); show more balls, or use --method ml"
        )
    return keep_balls(obs, keep)


def one_pair(obs: Observations) -> np.ndarray:
    """(K,) bool over the balls of the cell: of each artefact, the two seen balls that are farthest apart."""
    keep = np.zeros(len(obs.cell.ball_ids), bool)
    for a in range(len(obs.cell.artefacts)):
        own = np.intersect1d(np.flatnonzero(obs.cell.ball_artefact == a), obs.ball)
        if len(own) > 1:
            apart = [(np.linalg.norm(obs.cell.ball_centres[i] - obs.cell.ball_centres[j]), i, j) for i, j in combinations(own, 2)]
            keep[list(max(apart)[1:])] = True
    return keep


def keep_balls(obs: Observations, keep: np.ndarray) -> Observations:
    """The centres of the balls where ``keep`` (K,) bool holds, and the poses that show any of them."""
    rows = keep[obs.ball]
    part = replace(
        obs,
        **{name: None if getattr(obs, name) is None else getattr(obs, name)[rows] for name in CENTRE_COLUMNS},
        extra={k: v if k.startswith("poses.") else v[rows] for k, v in obs.extra.items()},
    )
    return part.select(np.bincount(part.pose, minlength=part.n_poses) > 0)


def width(points: np.ndarray) -> float:
    """Second largest extent (mm, rms) of points (K, 3): zero for points on one line."""
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points)))
