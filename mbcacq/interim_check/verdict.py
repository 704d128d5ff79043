"""What a history of checks says: as before or not, and what changed, where, since when, by how much."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import logsumexp

from mbcacq.errors import DeviceFault
from mbcacq.estimation.solver import one_thread
from mbcacq.interim_check.e_process import EProcess, Followed, Level, weight_of
from mbcacq.interim_check.history import CheckHistory
from mbcacq.interim_check.options import OPTIONS
from mbcacq.interim_check.planned_check import PlannedCheck
from mbcacq.interim_check.possible_changes import SCANNER, UNNAMED, PossibleChange, joint_columns, rows_of, station_columns
from mbcacq.model.json_text import keyed

AS_BEFORE, CHANGED = "as_before", "changed"
LEAST_COMMON = 0.5  # of the centres of a check: with fewer it is another check
POWER = 1.2816  # quantile of the normal distribution: a change is noticed with a probability of 90 %
THRESHOLD = float(np.log(2 / OPTIONS.false_alarms))  # of either e-process
UNSEEN = 1e4  # usual changes: what is noticed no sooner is not seen at all


@dataclass(frozen=True)
class Suspect:
    """One thing that may have changed. probability: among all changes, given a change; size, std: of its coefficients, in ``units``.
    explains: share of what is seen of the change, in that of the best description."""

    name: str
    where: str
    probability: float
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    size: tuple[float, ...]
    std: tuple[float, ...]
    explains: float = 1.0

    @property
    def label(self) -> str:
        return f"{self.name.replace('_', ' ')} ({self.where})"


Noticed = Annotated[tuple[str, str, float, str], keyed("name", "where", "size", "unit")]


@dataclass(frozen=True)
class PutRight:
    """A change that was undone: the check ``first`` was after it, ``end`` the first one as before again; suspect: most probably."""

    first: int
    end: int
    suspect: Suspect


@dataclass(frozen=True)
class CheckVerdict:
    """What a check says.

    Attributes
    ----------
    verdict : str
        'as_before' or 'changed'.
    log_e : float
        Logarithm of the e-process since the first check.
    log_e_calibration
        Logarithm of the e-process since the calibration.
    log_threshold : float
        Logarithm of the threshold of either.
    suspects : tuple[Suspect, ...]
        The most probable one first, and all that cannot be told apart from it.
    since : Annotated[int or None, Field(exclude=True)]
        Index of the first check after the change, most probably.
    between
        The same, from and to with 90 %; None while nothing changed.
    noticed
        The change of each that is noticed within a week with 90 %: (name, where, size, unit).
    noise : Annotated[float, Field(alias=noise_level)]
        Level of the noise that fits best, in that of the calibration.
    day : Annotated[float, Field(alias=day_level)]
        Level of the changes from day to day, in the usual ones.
    put_right : Annotated[tuple[PutRight, ...], Field(exclude=True)]
        Changes that were undone since. Their checks are left out of all else.
    """

    verdict: str
    log_e: float
    log_e_calibration: Annotated[float, Field(alias="log_e_since_calibration")]
    log_threshold: float
    suspects: tuple[Suspect, ...]
    since: Annotated[int | None, Field(exclude=True)]
    between: Annotated[tuple[int, int] | None, Field(exclude=True)]
    noticed: Annotated[tuple[Noticed, ...], Field(alias="noticed_within_a_week")]
    noise: Annotated[float, Field(alias="noise_level")]
    day: Annotated[float, Field(alias="day_level")]
    put_right: Annotated[tuple[PutRight, ...], Field(exclude=True)] = ()

    @property
    def changed(self) -> bool:
        return self.verdict == CHANGED

    @property
    def near(self) -> bool:
        """Nothing changed by the verdict, at odds that would be enough to give a change a name."""
        return not self.changed and max(self.log_e, self.log_e_calibration) > np.log(OPTIONS.class_odds)


@dataclass(frozen=True)
class Evidence:
    """The measured days of a history as rows, with the e-process of the rows that all days have. keep: (R,) bool of the planned rows;
    raised: an alarm was raised on one of the days."""

    process: EProcess
    changes: tuple[PossibleChange, ...]
    days: np.ndarray
    keep: np.ndarray
    raised: bool = False


def evidence_of(check: PlannedCheck, history: CheckHistory) -> Evidence:
    """The e-process of a history, by the centres that every day has."""
    common = set(check.keys).intersection(*(day.residual.keys() for day in history.days))
    kept = [key in common for key in check.keys]
    keep = np.repeat(kept, 3) & check.shown
    if sum(kept) < LEAST_COMMON * len(kept):
        raise DeviceFault(
            f"only {sum(kept)} of {len(kept)} balls of the check were found on all of its days; clear the views and begin a new --history"
        )
    measured = [np.concatenate([day.residual.get(key, np.zeros(3)) for key in check.keys]) for day in history.days]
    days = np.array(measured)[:, keep]
    changes = tuple(r.select(keep) for r in check.changes)
    process = EProcess(check.rows.select(keep), [r.columns for r in changes], np.array([r.weight for r in changes]))
    return Evidence(process, changes, days, keep, any((day.log_e or 0.0) >= THRESHOLD for day in history.days))


def verdict_of(check: PlannedCheck, history: CheckHistory) -> CheckVerdict:
    """What all checks so far say together."""
    with one_thread():
        return verdict_by(evidence_of(check, history), check)


def verdict_by(evidence: Evidence, check: PlannedCheck) -> CheckVerdict:
    """What the rows of all days say together."""
    process, T, raised = evidence.process, len(evidence.days), evidence.raised
    if T > 1:
        followed = process.follow(evidence.days)
        log_e, level, null = followed.log_e(T), followed.level(T), int(np.argmax(followed.null[:, -1]))
        raised = raised or log_e >= THRESHOLD
        if raised and (undone := _undone(followed, T)) is not None:
            return _since_put_right(evidence, check, *undone)
    else:
        log_e, level, null = 0.0, process.usual, process.usual
    factors, estimates = _since_calibration(check, evidence, process.levels[null])
    log_first = float(np.asarray(logsumexp(factors)))
    at_first = log_first >= THRESHOLD and log_first > log_e
    changed, suspects = raised or at_first, ()
    since = between = None
    if at_first:
        suspects, since, between = _ranked(evidence.changes, factors, estimates), 0, (0, 0)
    elif raised:
        suspects, since, between = _suspects_since(evidence, level, T)
    shown, seen, said = process.levels[level if changed else null], noticed(evidence, null, T), CHANGED if changed else AS_BEFORE
    return CheckVerdict(said, log_e, log_first, THRESHOLD, suspects, since, between, noticed=seen, noise=shown.noise, day=shown.day)


Estimate = tuple[np.ndarray, np.ndarray, float]
Estimates = list[Estimate]


def _undone(followed: Followed, T: int) -> tuple[int, int, int] | None:
    """First check after a change, first one after its end, and the level of the noise, where the odds for the end are twenty to one."""
    process, begins, stands = followed.process, np.arange(1, T), []
    ended = np.full((len(process.levels), T, T), -np.inf)
    for h, sums in followed.sums.items():
        null = followed.null[h, -1] + process.log_weight
        onsets = process.log_onsets(begins)
        stands.append(logsumexp(null + onsets[:, None, None] + process.log_factors(h, sums, T)))
        for n in begins[:-1]:
            ends = np.arange(n + 1, T)
            each = np.asarray(logsumexp(null + process.log_factors(h, sums, T, np.full_like(ends, n), ends), axis=(1, 2)))
            ended[h, n, n + 1 :] = each + onsets[n - 1] - np.log(len(ends))
    if np.logaddexp.reduce(ended.ravel()) - np.logaddexp.reduce(stands) < np.log(OPTIONS.class_odds):
        return None
    level, first, end = np.unravel_index(int(np.argmax(ended)), ended.shape)
    return int(first), int(end), int(level)


def _since_put_right(evidence: Evidence, check: PlannedCheck, first: int, end: int, level: int) -> CheckVerdict:
    """What the rows say without the checks from a change until its end."""
    days, rest = evidence.days, [k for k in range(len(evidence.days)) if not first <= k < end]
    suspects, *_ = _suspects_since(replace(evidence, days=days[:end]), level, end)
    said = verdict_by(replace(evidence, days=days[rest], raised=False), check)
    since, between = (None if said.since is None else rest[said.since]), said.between and (rest[said.between[0]], rest[said.between[1]])
    others = (replace(one, first=rest[one.first], end=rest[one.end]) for one in said.put_right)
    return replace(said, since=since, between=between, put_right=(PutRight(first, end, suspects[0]), *others))


def _since_calibration(check: PlannedCheck, evidence: Evidence, level: Level) -> tuple[np.ndarray, Estimates]:
    """(A,) log of what each possible change between the calibration and the first check adds to the e-value, and its estimate.

    The mean of all days against the prediction, whose uncertainty is the calibration's covariance, what a good arm is off beyond its model,
    and where the artefacts stand, which nobody knew. The null takes the best level of noise. That the calibration's statement is true is
    assumed, not bounded. Single centres may be off for ever (certificate, lens), and are no change since the calibration.
    """
    known = _of_calibration(check, evidence)
    free = np.concatenate([rows_of(part) for part in station_columns(check.obs, check.prediction).values()], axis=1)[evidence.keep]
    rows, mean = evidence.process.rows, evidence.days.mean(axis=0)
    null, log, estimates = [], [], []
    for noise in OPTIONS.noise_levels:
        days = (noise**2 * rows.noise + level.day**2 * rows.daily @ rows.daily.T) / len(evidence.days)
        weight, log_det = weight_of(days + known, free)
        null.append(-0.5 * (mean @ weight @ mean + log_det))
        found = [_single(change, weight, mean) for change in evidence.changes]
        log.append([v for v, _ in found])
        estimates.append([e for _, e in found])
    best = int(np.argmax(null))
    relative = np.array(null) - null[best] - np.log(len(null))
    return np.asarray(logsumexp(np.array(log) + relative[:, None], axis=0)), estimates[best]


def _single(change: PossibleChange, weight: np.ndarray, mean: np.ndarray) -> tuple[float, Estimate]:
    """log of weight times Bayes factor of one change, and its estimate."""
    weighted = change.columns.T @ weight
    b, S = weighted @ mean, weighted @ change.columns
    each = [_log_factor(S, b, size) for size in OPTIONS.sizes]
    log = np.logaddexp.reduce(each) - np.log(len(each)) + np.log(change.weight)
    return (-np.inf if change.where == SCANNER else float(log)), _estimate(change, S, b, OPTIONS.sizes[int(np.argmax(each))])


def _of_calibration(check: PlannedCheck, evidence: Evidence) -> np.ndarray:
    """(R, R) covariance of the prediction: the calibrated cell, and what a good arm is off beyond its model at each pose."""
    obs, prediction, cell = check.obs, check.prediction, check.cell
    T = prediction.T_base_scanner[obs.pose][:, :3, :3]
    A = rows_of(np.swapaxes(T, 1, 2) @ cell.point_errors(obs.q[obs.pose], prediction.xyz))[evidence.keep]
    J = rows_of(joint_columns(check.state, prediction) * OPTIONS.discrepancy)[evidence.keep]
    pose = np.repeat(obs.pose, 3)[evidence.keep]
    return A @ A.T + (J @ J.T) * (pose[:, None] == pose)


def _log_factor(S: np.ndarray, b: np.ndarray, size: float) -> float:
    """log Bayes factor of coefficients a ~ N(0, size^2) with information S (k, k) and score b (k,)."""
    M = np.eye(len(b)) + size**2 * S
    return float(0.5 * size**2 * b @ np.linalg.solve(M, b) - 0.5 * np.linalg.slogdet(M)[1])


def _estimate(change: PossibleChange, S: np.ndarray, b: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients (k,) of a change and their standard deviations, in its units, and the chi square that they explain."""
    covariance = np.linalg.inv(np.eye(len(b)) / size**2 + S)
    a = covariance @ b
    return change.usual * a, change.usual * np.sqrt(np.diag(covariance)), float(2 * a @ b - a @ S @ a)


def _suspects_since(evidence: Evidence, level: int, T: int) -> tuple[tuple[Suspect, ...], int, tuple[int, int]]:
    """Suspects, the first check after the change, and from and to with 90 %."""
    process, lv = evidence.process, evidence.process.levels[level]
    sums = np.cumsum(evidence.days @ lv.scores, axis=0)
    prior = process.log_onsets(np.arange(1, T))[:, None, None] + process.log_weight
    joint = process.log_factors(level, sums, T) + prior
    by_onset = np.asarray(logsumexp(joint, axis=(1, 2)))
    share = np.cumsum(np.exp(by_onset - logsumexp(by_onset)))
    onset = int(np.argmax(by_onset))
    low, high = int(np.searchsorted(share, 0.05)), int(np.searchsorted(share, 0.95 - 1e-12))
    by_change = np.asarray(logsumexp(joint, axis=(0, 1)))
    estimates = []
    for k, change in enumerate(evidence.changes):
        n, size = np.unravel_index(int(np.argmax(joint[:, :, k])), joint.shape[:2])
        days_before = int(n) + 1
        moved = evidence.days[days_before:].mean(axis=0) - evidence.days[:days_before].mean(axis=0)
        W = lv.weight * (days_before * (T - days_before) / T)
        S, b = change.columns.T @ W @ change.columns, change.columns.T @ W @ moved
        estimates.append(_estimate(change, S, b, OPTIONS.sizes[int(size)]))
    return _ranked(evidence.changes, by_change, estimates), onset + 1, (low + 1, min(high, T - 2) + 1)


def _ranked(changes: tuple[PossibleChange, ...], log: np.ndarray, estimates: Estimates) -> tuple[Suspect, ...]:
    """The most probable change, and those that are not told from it; where that is unnamed, the most probable name too."""
    probability = np.exp(log - logsumexp(log))
    order = [int(k) for k in np.argsort(-log)]
    chosen = [k for k in order if probability[k] * OPTIONS.class_odds >= probability[order[0]]]
    if all(changes[k].name == UNNAMED for k in chosen):
        chosen.append(next(k for k in order if changes[k].name != UNNAMED))
    most = max(chi2 for *_, chi2 in estimates)
    out = []
    for k in chosen:
        r, (size, std, chi2) = changes[k], estimates[k]
        named = r.name != UNNAMED
        sizes, stds = (tuple(float(v) for v in x) if named else () for x in (size, std))
        names, units = (r.parameters, r.units) if named else ((), ())
        out.append(Suspect(r.name, r.where, float(probability[k]), names, units, sizes, stds, explains=chi2 / max(most, 1e-300)))
    return tuple(out)


def noticed(evidence: Evidence, level: int, T: int) -> tuple[tuple[str, str, float, str], ...]:
    """The change of a joint's zero, of the mount or an artefact, one coefficient at a time, that is noticed within a week with 90 %."""
    process, lv = evidence.process, evidence.process.levels[level]
    days, week = max(T, 7), 7
    n = days * week / (days + week)
    onset = float(process.log_onsets(np.array([days]))[0])
    out = []
    for change, weight in zip(evidence.changes, process.log_weight, strict=True):
        if change.name not in ("mastering", "mount", "artefact"):
            continue
        information = n * np.einsum("rk,rs,sk->k", change.columns, lv.weight, change.columns, optimize=True)
        cost = THRESHOLD - onset - weight + np.log(len(OPTIONS.sizes) * len(process.levels))
        cost = cost + 0.5 * len(change.usual) * np.log1p(information)
        size = change.usual * (np.sqrt(2 * cost) + POWER) / np.sqrt(np.maximum(information, 1e-300))
        out += [
            (change.name, f"{change.where} {p}" if len(size) > 1 else change.where, float(v), u)
            for p, v, u, usual in zip(change.parameters, size, change.units, change.usual, strict=True)
            if v < UNSEEN * usual
        ]
    return tuple(out)
