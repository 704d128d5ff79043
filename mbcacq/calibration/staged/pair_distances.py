"""Which pairs of measured centres enter the distance constraint (Eq. 21-24), and the noise of every pose carried through its least squares.

The equations speak of "the two points" a and b, "the center points of two spheres on the stereo target". About repetition they only say
that "the position of the stereo target was varied, and the above process was repeated": one pair of balls, at every position. That is
``one``. Nothing there takes four balls (they make the virtual point of Eq. 5) or all of them; read as an equation for *any* two balls it
would allow ``all``. Which two is not said: the two farthest apart are taken. Nor is said which poses: all pairs of poses of a position are
taken.

Distances are not independent. Each centre enters many of them, the angle adjustment ties the centres of a scan, and the repeatability of
the joints moves all of them together. Plain least squares of the distances understates the uncertainty several times. The method itself has
no noise model, so the hierarchical one is used, with its two levels taken from the same data. The scanner's level follows from the shape of
each scan against the certificate, the joints' from the errors of the distances beyond that (method of moments).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.sparse import csr_array

from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import LEAST_POINT
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
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
    Artefacts with fewer than four are left out. Raises CalibrationError if no artefact shows four balls that are not on one line."""
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


@dataclass(frozen=True)
class Measured:
    """The noise of the centres used.

    Attributes
    ----------
    shape : ndarray
        (3,) mm, its sigma along the scanner's axes.
    smoother : tuple[ndarray, ...] or None
        Per pose, what became of the noise of its centres (3 B, 3 B), in the order of the centres, or None: they were not adjusted.
    """

    shape: np.ndarray
    smoother: tuple[np.ndarray, ...] | None = None


def scanner_noise(obs: Observations) -> np.ndarray:
    """(3,) mm: sigma of a centre along the scanner's axes, from the shape of each scan against the certificate; as the stated
    noise among the axes, or alike. Poses with fewer than three balls are not used."""
    stated = np.ones(3) if obs.cell.noise_mm is None else np.maximum(obs.cell.noise_mm, LEAST_POINT)
    T = se3.fit_rigid_transforms(obs.cell.ball_centres[obs.ball], obs.xyz, obs.pose, obs.n_poses)
    known = se3.apply(T[obs.pose], obs.cell.ball_centres[obs.ball])
    squares, expected = 0.0, 0.0
    for p in np.flatnonzero(np.bincount(obs.pose, minlength=obs.n_poses) >= 3):
        rows = obs.pose == p
        around = known[rows] - known[rows].mean(axis=0)
        rigid = np.concatenate([np.tile(np.eye(3), (len(around), 1, 1)), -se3.skew(around)], axis=2).reshape(-1, 6)
        U, size, _ = np.linalg.svd(rigid / np.linalg.norm(rigid, axis=0), full_matrices=False)
        U = U[:, size > 1e-6]
        e = (obs.xyz[rows] - known[rows]).reshape(-1)
        squares += float(np.sum((e - U @ (U.T @ e)) ** 2))
        expected += float(np.sum((1 - np.sum(U**2, axis=1)) * np.tile(stated**2, len(around))))
    return np.maximum(np.sqrt(squares / expected) * stated, LEAST_POINT) if expected > 0 else np.full(3, 0.02)


def points_and_directions(
    chain: Chain, hand_eye: np.ndarray, obs: Observations, at: PairDistances
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frames of the arm (P, n+1, 4, 4), T_base_scanner (P, 4, 4) and the centres in the base (M, 3); of each pair its length (K,) mm and
    the direction (K, 3) from b to a."""
    frames = chain.frames(obs.q)
    T = frames[:, -1] @ hand_eye
    point = se3.apply(T[obs.pose], obs.xyz)
    apart = point[at.a] - point[at.b]
    length = np.linalg.norm(apart, axis=1)
    return frames, T, point, length, apart / length[:, None]


def propagate(
    chain: Chain,
    hand_eye: np.ndarray,
    obs: Observations,
    at: PairDistances,
    J: np.ndarray,
    residual: np.ndarray,
    inverse: np.ndarray,
    measured: Measured,
) -> tuple[np.ndarray, Noise]:
    """Covariance (g, g) of the least squares J x = residual, J (K, g), of the distances, and the noise that was found and used.

    inverse: (g, g) of J' J, zero where unobservable.
    """
    q, pose = obs.q, obs.pose
    frames, T, point, _, u = points_and_directions(chain, hand_eye, obs, at)
    rows, count = np.arange(len(at.a)), len(pose)
    at_centre = (3 * np.concatenate([at.a, at.b])[:, None] + np.arange(3)).ravel()
    D = csr_array((np.concatenate([u, -u]).ravel(), (np.repeat(np.tile(rows, 2), 3), at_centre)), shape=(len(rows), 3 * count))
    S = (D.T @ J).reshape(count, 3, -1)
    weight = np.zeros((count, 3, 3))
    square = u[:, :, None] * u[:, None, :]
    for ends in (at.a, at.b):
        weight += np.stack([np.bincount(ends, square.reshape(-1, 9)[:, c], count) for c in range(9)], axis=1).reshape(-1, 3, 3)
    twists = chain.joint_twists(frames)[pose]
    joint = np.swapaxes(twists[..., :3] + np.cross(twists[..., 3:], point[:, None]), 1, 2)  # (M, 3, n)
    by_scanner, scanner_trace = _scanner(pose, T[pose, :3, :3], S, weight, measured)
    by_pose = np.zeros((len(q), joint.shape[2], S.shape[2]))
    np.add.at(by_pose, pose, np.swapaxes(joint, 1, 2) @ S)
    by_joint = np.einsum("png,pnh->gh", by_pose, by_pose)
    joint_trace = float(np.einsum("mik,mij,mjk->", joint, weight, joint))
    # E |residual|^2 = tr(D Omega D') less what the fit takes of it.
    expected_scanner = scanner_trace - np.sum(inverse * by_scanner)
    expected_joint = joint_trace - np.sum(inverse * by_joint)
    variance = max(float(residual @ residual) - expected_scanner, 0.0) / expected_joint if expected_joint > 0 else 0.0
    covariance = inverse @ (by_scanner + variance * by_joint) @ inverse
    return covariance, Noise(measured.shape, np.full(chain.n, np.sqrt(variance)))


def _scanner(pose: np.ndarray, R: np.ndarray, S: np.ndarray, weight: np.ndarray, measured: Measured) -> tuple[np.ndarray, float]:
    """(g, g) sum over poses of S' Omega S, and the trace of ``weight`` Omega, for the scanner's noise. R: (M, 3, 3) scanner in base."""
    S = np.swapaxes(R, 1, 2) @ S
    weight = np.swapaxes(R, 1, 2) @ weight @ R
    if measured.smoother is None:
        weighed = measured.shape[:, None] * S
        return np.einsum("mcg,mch->gh", weighed, weighed), float(np.einsum("mcc,c->", weight, measured.shape**2))
    total, trace = np.zeros((S.shape[2],) * 2), 0.0
    for p in np.unique(pose):
        rows = np.flatnonzero(pose == p)
        A = measured.smoother[p] * np.tile(measured.shape, len(rows))
        own = A.T @ S[rows].reshape(-1, S.shape[2])
        total += own.T @ own
        blocks = A.reshape(len(rows), 3, -1)
        trace += float(np.einsum("mci,mcd,mdi->", blocks, weight[rows], blocks))
    return total, trace
