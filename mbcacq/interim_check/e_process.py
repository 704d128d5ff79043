"""Whether repeated measurements changed: a test martingale over days, valid at every look.

A check measures the same R rows every day: r_t = mu + noise of the day, N(0, Sigma_h). The null says that mu is one and the same on all
days, whatever it is; Sigma_h is one of several levels h of the noise of measuring and of changes from day to day. A change k with onset
after n of the days says that mu moves there by G_k a, a ~ N(0, size^2).

Densities of the differences between days are compared (a maximal invariant under shifts of mu), so that mu needs no prior. Both have the
flat prior, and their ratio is a likelihood ratio whatever mu is (Perez-Ortiz, Lardy, de Heide and Grunwald 2024). Over changes, sizes and
onsets it is averaged; over the levels of noise the null takes its best (universal inference; Wasserman, Ramdas and Balakrishnan 2020):

    E_t = sum over k, h, sizes, onsets of weight x density of the change / max over h of the density of the null

Under the null of any mu and any level h, E is at most a martingale of mean one: P(E_t >= 1 / alpha for any t) <= alpha (Ville 1939). This
is a bound if the noise is normal with one of the levels. Which name gets the odds is calibration: it depends on sizes and list.

By sufficiency the rows enter through y_t = G' Sigma^-1 r_t alone. Let T and C be their sums over all t and over the first n days. The score
of a change after day n is S = n T / t - C, with information n (t - n) / t times G' Sigma^-1 G. A change that is undone after day e has the
sum over its own days and their number m in place of T - C and t - n.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from mbcacq.interim_check.options import OPTIONS, CheckOptions


@dataclass(frozen=True)
class Rows:
    """The rows of a check, R = 3 a measured centre.

    Attributes
    ----------
    noise : ndarray
        (R, R) covariance of measuring, as the calibration has it.
    daily : ndarray
        (R, d) what one standard deviation of each change from day to day does.
    free : ndarray
        (R, f) what is placed anew every day and says nothing, or (R, 0).
    """

    noise: np.ndarray
    daily: np.ndarray
    free: np.ndarray

    def select(self, keep: np.ndarray) -> Rows:
        """The rows where ``keep`` (R,) bool holds."""
        return Rows(self.noise[np.ix_(keep, keep)], self.daily[keep], self.free[keep])


@dataclass(frozen=True)
class Level:
    """One level of the noise, with the changes' columns turned so that those of a change are independent under it.

    weight: (R, R) inverse covariance, without what is free; log_det: of the covariance; scores: (R, K) of all columns, y = scores' r;
    information: (K,) of each.
    """

    noise: float
    day: float
    weight: np.ndarray
    log_det: float
    scores: np.ndarray
    information: np.ndarray


class EProcess:
    """The e-process of a set of rows and changes. columns: of each change (R, k), of one usual size of each coefficient; weights: (A,)
    prior probability of each change, summing to one."""

    def __init__(self, rows: Rows, columns: Sequence[np.ndarray], weights: np.ndarray, options: CheckOptions = OPTIONS) -> None:
        self.options, self.rows = options, rows
        self.columns = tuple(columns)
        self.log_weight = np.log(weights)
        self.first = np.cumsum([0, *(c.shape[1] for c in columns[:-1])])  # where each change's columns begin
        self.levels = tuple(self._level(s, g) for s in options.noise_levels for g in options.day_levels)
        self.usual = [(lv.noise, lv.day) for lv in self.levels].index((1.0, 1.0))  # as the calibration and the usual days have it

    def _level(self, noise: float, day: float) -> Level:
        weight, log_det = weight_of(noise**2 * self.rows.noise + day**2 * self.rows.daily @ self.rows.daily.T, self.rows.free)
        scores, information = [], []
        weighted = np.split(weight @ np.concatenate(self.columns, axis=1), self.first[1:], axis=1)
        for columns, score in zip(self.columns, weighted, strict=True):
            values, vectors = np.linalg.eigh(columns.T @ score)
            scores.append(score @ vectors)
            information.append(np.maximum(values, 0.0))
        return Level(noise, day, weight, log_det, np.concatenate(scores, axis=1), np.concatenate(information))

    def null(self, days: np.ndarray) -> np.ndarray:
        """(H, T) log densities of the differences between days (T, R), up to a constant, cumulated over the days."""
        T = len(days)
        before = np.cumsum(days, axis=0)[:-1] / np.arange(1, T)[:, None]
        u = (days[1:] - before) * np.sqrt(np.arange(1, T) / np.arange(2, T + 1))[:, None]
        each = [-0.5 * (np.einsum("tr,rs,ts->t", u, lv.weight, u, optimize=True) + lv.log_det) for lv in self.levels]
        return np.concatenate([np.zeros((len(self.levels), 1)), np.cumsum(each, axis=1)], axis=1)

    def possible(self, days: np.ndarray) -> list[int]:
        """The levels that take part beside the changes: the others are hopeless by the scatter from each day to the next, of which a change
        spoils one at most. Leaving a level out can only lessen the e-process."""
        v = np.diff(days, axis=0) / np.sqrt(2)
        each = [-0.5 * (np.einsum("tr,tr->t", v @ lv.weight, v) + lv.log_det) for lv in self.levels]
        score = len(v) * np.median(each, axis=1)
        return np.flatnonzero(score > score.max() - self.options.hopeless).tolist()

    def follow(self, days: np.ndarray) -> Followed:
        """The e-process of measured days (T, R), T at least two."""
        possible = self.possible(days)
        return Followed(self, self.null(days), {h: np.cumsum(days @ self.levels[h].scores, axis=0) for h in possible})

    def log_factors(
        self, level: int, sums: np.ndarray, t: int, after: np.ndarray | None = None, until: np.ndarray | None = None
    ) -> np.ndarray:
        """(onsets, sizes, A) log Bayes factors of every change against no change after t days.

        sums: (t, K) cumulated scores of the days. after: after how many days the change is, default 1, 2, ... t - 1; until: after how many
        it is undone, default not.
        """
        n = np.arange(1, t) if after is None else after
        e = np.full_like(n, t) if until is None else until
        S = sums[e - 1] - sums[n - 1] - ((e - n) / t)[:, None] * sums[t - 1]
        information = ((e - n) * (t - e + n) / t)[:, None] * self.levels[level].information
        out = []
        for size in self.options.sizes:
            v = size**2
            out.append(np.add.reduceat(0.5 * v * S**2 / (1 + v * information) - 0.5 * np.log1p(v * information), self.first, axis=1))
        return np.stack(out, axis=1)

    def log_onsets(self, after: np.ndarray) -> np.ndarray:
        """log prior probability of a change after so many days; over all days to come it sums to one."""
        c = self.options.onset_days
        return np.log(c) - np.log(c + after - 1) - np.log(c + after)


@dataclass(frozen=True)
class Followed:
    """The e-process of measured days. null: (H, T) log densities of the null; sums: (T, K) cumulated scores of each level that
    takes part."""

    process: EProcess
    null: np.ndarray
    sums: Mapping[int, np.ndarray]

    def log_e(self, t: int, after: np.ndarray | None = None, onsets: np.ndarray | None = None) -> float:
        """log of the e-process after t days, t at least two. after, onsets: changes after so many days that are summed over, and the log
        prior probability of each; default all of them."""
        process = self.process
        after = np.arange(1, t) if after is None else after
        onsets = process.log_onsets(after) if onsets is None else onsets
        prior = onsets[:, None, None] + process.log_weight - np.log(len(process.options.sizes) * len(process.levels))
        null = self.null[:, t - 1]
        parts = [null[h] + logsumexp(prior + process.log_factors(h, sums, t, after)) for h, sums in self.sums.items()]
        return float(logsumexp(parts) - null.max())

    def level(self, t: int) -> int:
        """The level under which a change is most probable after t days."""
        process, null = self.process, self.null[:, t - 1]
        best = {h: null[h] + float(process.log_factors(h, sums, t).max()) for h, sums in self.sums.items()}
        return max(best, key=lambda h: best[h])


def weight_of(covariance: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, float]:
    """Inverse of a covariance (R, R) without what is free (R, f), and the log determinant that belongs to it."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.inv(root)
    log_det = 2 * float(np.sum(np.log(np.diag(root))))
    if free.shape[1]:
        q, r = np.linalg.qr(white @ free)
        log_det += 2 * float(np.sum(np.log(np.abs(np.diag(r)))))
        white = white - q @ (q.T @ white)
    return white.T @ white, log_det
