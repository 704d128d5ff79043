"""Simple faults, made while a recording was measured, that explain its misfit. Each cheap test looks for one of them.

A place that moved, a scanner that slipped or a joint that stepped at a moment are further columns of the linear problem. Their gain of chi
square follows from the solution without another fit, and so does that of a pose that is left out (Cook 1977; Belsley, Kuh, Welsch 1980).
One wrong pose of a small recording raises the estimated joint noise so far that no outlier test finds it. With the noise of the data sheet
instead, leaving that pose out takes most of the misfit away, while leaving out any other does not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.change import kinds_of_change
from mbcacq.calibration.change_found import in_words
from mbcacq.calibration.published_cell import warned
from mbcacq.estimation.options import Noise
from mbcacq.estimation.pose_information import chi2_quantile
from mbcacq.estimation.solution import Solution
from mbcacq.estimation.solver import solve
from mbcacq.estimation.step_test import StepTest
from mbcacq.estimation.variance_components import first_noise
from mbcacq.model.cell import Cell

EXPLAINED = 0.7  # share of the misfit beyond the noise that a story must remove to be said
SCATTER = 6.0  # standard deviations of chi square, within which a misfit needs no story
APART = 20.0  # of chi square to the best story of another kind: odds of e^10; a wrong name is worse than none
SAME = 20.0  # of chi square: moments that are this near are said as a range
MOST_POSES = 400  # whose moments are looked at


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
        Number of the pose that it is about, None if it is about no single one.
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


# When joint noise contradicts a data sheet, and when one pose is the reason.
NOISE_FACTOR = 3.0  # of the data sheet's: what arms in good order reach under other conditions than the sheet's (load, time)
FALSE_ALARMS = 1e-3  # nominal level of the test, divided among the poses; the rate itself is not yet measured
LEAST_DIFFERENCE = 20.0  # of chi square to the second pose: odds of e^10; a wrong name is worse than none
CONSISTENT_NORMAL_DEVIATE = 4.0  # of the chi square that remains: without the pose, the data sheet's noise must do
LEAST_DOF = 6  # that must be left without the pose: fewer explain anything


@dataclass(frozen=True)
class Deletion:
    """The change by leaving a pose out. chi2: (P,) decrease of chi square; rank: (P,) of degrees of freedom; shift: (P, h) of
    parameters."""

    chi2: np.ndarray
    rank: np.ndarray
    shift: np.ndarray


def deletions(solution: Solution, which: np.ndarray) -> Deletion:
    """Deletion of each pose, in the order of the observations, by the linearised solution. which: (h,) indices of parameters."""
    normal, rows, X = solution.normal, solution.normal.rows, solution.X
    g = normal.size
    A, y = normal.reduce(X[..., :g], X[..., g : g + 6])
    residual = X[..., -1]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.information), 1e-300))
    covariance = scale[:, None] * np.linalg.pinv(scale[:, None] * normal.information * scale, hermitian=True) * scale
    gain = covariance @ np.swapaxes(A, 1, 2)  # (P, g, m)
    value, vector = np.linalg.eigh(np.eye(A.shape[1]) - A @ gain - y @ np.swapaxes(y, 1, 2))
    # A direction that the other poses do not determine (no redundancy) stays as it is when the pose is left out.
    kept = value > 1e-6
    along = np.einsum("pmk,pm->pk", vector, residual) * kept
    weighted = along / np.where(kept, value, 1.0)
    shift = -np.einsum("phm,pmk,pk->ph", gain[:, which], vector, weighted)
    out = Deletion(np.zeros(rows.n_poses), np.zeros(rows.n_poses), np.zeros((rows.n_poses, len(which))))
    out.chi2[rows.order] = np.sum(along * weighted, axis=1)
    used = np.any(X != 0.0, axis=2).sum(axis=1)
    out.rank[rows.order] = np.maximum(used - (~kept).sum(axis=1), 0)
    out.shift[rows.order] = shift
    return out


def joint_factor(noise: Noise, cell: Cell) -> float:
    """The joints' noise in units of what the arm's data sheet, or its class, allows; the median over the joints."""
    return float(np.median(noise.joint / first_noise(cell).joint))


def with_joint_noise_check(cell: CalibratedCell) -> CalibratedCell:
    """The cell, with a warning where the estimated joint noise is far beyond the arm's data sheet."""
    found = joint_noise_check(cell.adjustment.solution, cell.adjustment.noise, cell.covariance)
    return cell if found is None else warned(cell, joint_noise_sentence(found), joint_noise_check=found)


def joint_noise_check(solution: Solution, noise: Noise, covariance: np.ndarray) -> dict[str, Any] | None:
    """Factor by which the estimated joint noise exceeds the arm's data sheet, if by far, and the pose that explains it, if one does.

    covariance: (g, g) of the parameters, as stated. None if the noise is credible or the data sheet is silent.
    """
    obs, names = solution.lineariser.obs, solution.lineariser.layout.names
    allowed = first_noise(obs.cell).joint
    factor = joint_factor(noise, obs.cell)
    if not obs.cell.robot.repeatability_mm or factor <= NOISE_FACTOR:
        return None
    found: dict[str, Any] = {"joint_factor": factor, "allowed_joint_rad": allowed.tolist(), "pose": None}
    strict = solve(solution, replace(noise, joint=allowed), tolerance=1e-2)
    hand_eye = np.array([i for i, name in enumerate(names) if name.startswith("hand_eye.")], dtype=int)
    if (pose := _explaining_pose(strict, deletions(strict, hand_eye))) is None:
        return found
    shift = deletions(solution, hand_eye).shift[pose]
    std = np.sqrt(np.diag(covariance))[hand_eye]
    found["pose"] = int(obs.pose_id[pose])
    found["hand_eye_shift"] = dict(zip((names[i] for i in hand_eye), shift.tolist(), strict=True))
    found["hand_eye_sigmas"] = float(np.max(np.abs(shift) / std)) if len(hand_eye) else 0.0
    return found


def _explaining_pose(strict: Solution, deleted: Deletion) -> int | None:
    """Index of the pose whose deletion takes most of the misfit away, by an F test; None if there is none."""
    weights, lineariser = strict.weights, strict.lineariser
    used = weights.centre * weights.pose[lineariser.obs.pose]
    dof = lineariser.rows.width * float(used.sum()) + strict.prior.rows - lineariser.layout.size - int(strict.normal.station_rank.sum())
    rest_dof = dof - deleted.rank
    judged = (deleted.rank > 0) & (rest_dof >= LEAST_DOF)
    if not judged.any():
        return None
    rest = np.maximum(strict.cost - deleted.chi2, 1e-300) / np.maximum(rest_dof, 1.0)
    ratio = np.where(judged, deleted.chi2 / np.maximum(deleted.rank, 1.0) / rest, 0.0)
    p_value = fdtrc(np.maximum(deleted.rank, 1.0), np.maximum(rest_dof, 1.0), ratio)
    p_value = np.where(judged, p_value, 1.0)
    pose = int(np.argmin(p_value))
    left = strict.cost - deleted.chi2
    others = np.delete(left, pose)
    decided = others.size == 0 or others.min() - left[pose] > LEAST_DIFFERENCE
    consistent = left[pose] < chi2_quantile(rest_dof[pose], CONSISTENT_NORMAL_DEVIATE)
    return pose if p_value[pose] < FALSE_ALARMS / judged.sum() and decided and consistent else None


def joint_noise_sentence(found: dict[str, Any]) -> str:
    """The warning for a person."""
    text = f"The estimated joint noise is {found['joint_factor']:.1f} times what the arm's data sheet (repeatability_mm) allows"
    if found["pose"] is None:
        return f"{text}; something is not in the model, or poses do not belong to it. mbcacq diagnose looks for it."
    return (
        f"{text}. Look at pose {found['pose']} first: without it most of the misfit vanishes, and the hand-eye moves by "
        f"{found['hand_eye_sigmas']:.1f} of its stated standard uncertainties. Measure it again before it is left out."
    )
