"""Normal equations of a group of channels, segment by segment in time: any choice of columns is fitted and tested from them alone.

Per joint and segment (half a second of a recording) the products of all columns, and of the mismatch, with each other are kept. The fit on
some segments and the squared error on others are then small matrix products, however long the recording. The segments make
the folds: what is fitted and what is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mbcacq.diagnosis.motion.options import NUMBERS, RIDGE
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals


def shift_difference(signal: np.ndarray, step_s: float, delay_s: float) -> np.ndarray:
    """Change (T,) of an equidistant signal when it is read ``delay_s`` later: what the correction of a late channel adds to its
    mismatch. Beyond the ends the signal keeps its last value."""
    if delay_s == 0.0:
        return np.zeros(len(signal))
    from scipy.interpolate import CubicSpline  # takes long to import, and a report of poses comes by here

    time = step_s * np.arange(len(signal))
    return CubicSpline(time, signal)(np.clip(time + delay_s, 0.0, time[-1])) - signal


Part = list[tuple[int, slice]]  # stretches of recordings: (number of the run, samples)
Segment = tuple[int, slice, int]  # the same, whose normal equations are kept together, and the fold they belong to in the selection


def held_out_parts(runs: Sequence[MotionSignals]) -> tuple[list[Part], str]:
    """What is held out in turn: whole trajectories (several at once where there are many), or blocks in time where there is only one.

    The second value names the split, 'trajectory' or 'time block'.
    """
    lengths = [len(run.q) for run in runs]
    if len(lengths) > 1:
        number = min(len(lengths), NUMBERS.held_out_parts)
        return [[(k, slice(0, lengths[k])) for k in range(f, len(lengths), number)] for f in range(number)], "trajectory"
    return [[(0, block)] for block in _blocks(slice(0, lengths[0]), NUMBERS.held_out_parts)], "time block"


def segments(runs: Sequence[MotionSignals], held: int | None = None, learnt: int | None = None) -> tuple[list[Segment], str]:
    """All segments, and the name of the split. held: number of a part that is left out altogether; learnt: number of the trajectories, the
    first ones, from which anything is learnt (None: all).

    Folds are the remaining trajectories; of a single one, interleaved blocks.
    """
    parts, split = held_out_parts(runs[:learnt])
    remaining = [part for i, part in enumerate(parts) if i != held]
    by_trajectory = split == "trajectory" and len(remaining) > 1
    number = NUMBERS.interleaved_blocks if split == "trajectory" else NUMBERS.interleaved_blocks // NUMBERS.held_out_parts
    out: list[Segment] = []
    for fold, part in enumerate(remaining):
        for run, samples in part:
            step = runs[run].step_s
            if by_trajectory:
                out += [(run, s, fold) for s in _half_seconds(samples, step)]
                continue
            for i, block in enumerate(_blocks(samples, number)):
                out += [(run, s, i % NUMBERS.held_out_parts) for s in _half_seconds(block, step)]
    return out, split


def _half_seconds(samples: slice, step_s: float) -> list[slice]:
    return _blocks(samples, max(int((samples.stop - samples.start) * step_s / NUMBERS.segment_s), 1))


def _blocks(samples: slice, number: int) -> list[slice]:
    edges = np.linspace(0, samples.stop - samples.start, number + 1).astype(int)
    return [slice(samples.start + int(a), samples.start + int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]


MISMATCH = -1  # the number of the mismatch among the columns of every joint

Factor = tuple[np.ndarray, bool]
# Least square of a column. One that is zero where a recording was cut leaves its coefficient unknown, and the variance of that, which has
# RIDGE and this one below it, must stay a number.
LEAST_SQUARE = 1e-200


def weighted_sum(numbers: Sequence[np.ndarray], products: Sequence[np.ndarray], weights: np.ndarray, count: int) -> np.ndarray:
    """(P + 1, P + 1) sum over the joints of the products of their columns, which are numbered so, of P columns, mismatch last."""
    out = np.zeros((count + 1, count + 1))
    for own, product, weight in zip(numbers, products, weights, strict=True):
        at = np.where(own == MISMATCH, count, own)
        out[np.ix_(at, at)] += weight * product
    return out


class NormalStore:
    """Columns by number. The offset of a joint is its first column after the mismatch.

    held: a part of the recordings (``segments.held_out_parts``) that takes no part in anything; learnt: number of the recordings, the first
    ones, that take part (None: all).
    matrix[j]: (Ttot, c) mismatch and columns of one joint of the group, numbers[j]: (c,) their numbers; products[j]: (S, c, c) by
    segment; count: (S, J) samples used; prior: standard deviation of each column's coefficient.
    """

    def __init__(self, group: ChannelGroup, runs: tuple[MotionSignals, ...], held: int | None = None, learnt: int | None = None) -> None:
        self.group = group
        self.whole = held is None and learnt is None
        self.steps = [run.step_s for run in runs]
        self.lengths = [len(run.q) for run in runs]
        self.segments, self.split = segments(runs, held, learnt)
        self._run, self._fold = (np.array([one[k] for one in self.segments]) for k in (0, 2))
        self.folds = sorted(set(self._fold.tolist()))
        self._start = np.cumsum([0, *self.lengths])
        self._slices = [slice(self._start[r] + s.start, self._start[r] + s.stop) for r, s, _ in self.segments]
        self.training = np.zeros(self._start[-1])
        for samples in self._slices:
            self.training[samples] = 1.0
        joints = range(len(group.joints))
        self._use = [np.concatenate([u[:, j] for u in group.use]).astype(float) for j in joints]
        self.delay = 0.0
        self.matrix = [self._mismatch(j)[:, None] for j in joints]
        self.numbers = [np.array([MISMATCH]) for _ in joints]
        self.count = np.stack([[u[s].sum() for s in self._slices] for u in self._use], axis=1)
        self.products = [self._segment_products(z, z) for z in self.matrix]
        self._sums: list[tuple[np.ndarray, dict[int, np.ndarray]] | None] = [None for _ in joints]
        self.prior: list[float] = []
        offsets = [self.add([j], [np.ones((len(self.matrix[j]), 1))], self._offset_prior(j)) for j in joints]
        self.offset = [int(o[0]) for o in offsets]
        self.base = np.array(self.offset)
        if group.base[0].shape[2]:
            columns = [np.concatenate([b[:, j] for b in group.base]) for j in joints]
            self.base = np.concatenate([self.base, self.add(list(joints), columns, group.prior)])

    def _offset_prior(self, j: int) -> np.ndarray | None:
        """An offset of an angle is a convention. An offset of a torque is an error of its measurement, or friction that differs by
        direction, and small. If it were free, it would stand for a balancer or a mass wherever a joint moves little."""
        if self.group.refit or not self.group.signal:
            return None
        largest = max(float(np.abs(s[:, j]).max()) for s in self.group.signal)
        return np.array([NUMBERS.torque_offset * max(largest, 1e-12)])

    # columns

    def add(self, joints: list[int], columns: list[np.ndarray], prior: np.ndarray | None = None) -> np.ndarray:
        """New columns (Ttot, k) for each of these joints of the group, with common coefficients. Returns their numbers (k,)."""
        k = columns[0].shape[1]
        new = len(self.prior) + np.arange(k)
        self.prior += [np.inf] * k if prior is None else list(prior)
        for j, column in zip(joints, columns, strict=True):
            fresh = column * self._use[j][:, None]
            cross, own = self._segment_products(self.matrix[j], fresh), self._segment_products(fresh, fresh)
            upper = np.concatenate([self.products[j], cross], axis=2)
            lower = np.concatenate([np.swapaxes(cross, 1, 2), own], axis=2)
            self.products[j] = np.concatenate([upper, lower], axis=1)
            self.matrix[j] = np.concatenate([self.matrix[j], fresh], axis=1)
            self.numbers[j] = np.concatenate([self.numbers[j], new])
            self._sums[j] = None
        return new

    def add_many(self, batches: Sequence[tuple[int, np.ndarray]], sigmas: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Columns (Ttot, k) of single joints, each as (joint of the group, columns) with their priors (k,); faster than one by one.
        Returns their numbers."""
        out: list[np.ndarray] = [np.zeros(0, dtype=int)] * len(batches)
        for j in range(len(self.matrix)):
            own = [i for i, (joint, _) in enumerate(batches) if joint == j]
            if not own:
                continue
            columns, prior = np.concatenate([batches[i][1] for i in own], axis=1), np.concatenate([sigmas[i] for i in own])
            ends = np.cumsum([batches[i][1].shape[1] for i in own])[:-1]
            for i, part in zip(own, np.split(self.add([j], [columns], prior), ends), strict=True):
                out[i] = part
        return out

    def replace(self, numbers: np.ndarray, joints: list[int], columns: list[np.ndarray]) -> None:
        """Other columns (Ttot, k) for each of these joints instead of those numbered so."""
        for j, column in zip(joints, columns, strict=True):
            at = [int(np.flatnonzero(self.numbers[j] == i)[0]) for i in numbers]
            self._put(j, at, column * self._use[j][:, None])

    def forget(self, first: int) -> None:
        """Drop all columns numbered ``first`` and higher."""
        del self.prior[first:]
        for j, numbers in enumerate(self.numbers):
            keep = numbers < first
            if not keep.all():
                self.numbers[j], self.matrix[j] = numbers[keep], self.matrix[j][:, keep]
                self.products[j] = self.products[j][:, keep][:, :, keep]
                self._sums[j] = None

    def correct_delay(self, delay: float) -> None:
        """Read the recorded channel of all joints so many s later than it was recorded."""
        if delay == self.delay:
            return
        self.delay = delay
        for j in range(len(self.matrix)):
            self._put(j, [0], self._mismatch(j)[:, None])

    def _mismatch(self, j: int) -> np.ndarray:
        out = np.concatenate([m[:, j] for m in self.group.mismatch])
        if self.delay != 0.0:
            signals = zip(self.group.signal, self.steps, strict=True)
            out = out + np.concatenate([shift_difference(signal[:, j], step, self.delay) for signal, step in signals])
        return out * self._use[j]

    def _put(self, j: int, at: list[int], fresh: np.ndarray) -> None:
        self.matrix[j][:, at] = fresh
        cross = self._segment_products(self.matrix[j], fresh)
        self.products[j][:, :, at], self.products[j][:, at, :] = cross, np.swapaxes(cross, 1, 2)
        self._sums[j] = None

    def _segment_products(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(S, a, b) sums over each segment."""
        return np.stack([left[s].T @ right[s] for s in self._slices])

    # fit

    def normal(self, weights: np.ndarray, without: int | None = None) -> np.ndarray:
        """(P + 1, P + 1) weighted normal matrix of all columns, mismatch last; without: a fold left out."""
        sums = map(self._sum, range(len(self.numbers)))
        each = [total if without is None else total - folds[without] for total, folds in sums]
        return weighted_sum(self.numbers, each, weights, len(self.prior))

    def total(self, j: int) -> np.ndarray:
        """(c, c) products of the columns of a joint over all segments, mismatch first."""
        return self._sum(j)[0]

    def uncorrected(self, j: int) -> np.ndarray:
        """(c,) products of the columns of a joint with the mismatch as it was recorded, mismatch first."""
        if self.delay == 0.0:
            return self.total(j)[0]
        recorded = np.concatenate([m[:, j] for m in self.group.mismatch]) * self._use[j]
        return np.concatenate([[recorded @ (self.training * recorded)], (self.training * recorded) @ self.matrix[j][:, 1:]])

    def _sum(self, j: int) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Products over all segments, and over each fold."""
        sums = self._sums[j]
        if sums is None:
            folds = {f: self.products[j][self._fold == f].sum(axis=0) for f in self.folds}
            sums = self._sums[j] = (sum(folds.values(), np.zeros(())), folds)
        return sums

    def solve(self, N: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Coefficients (len(chosen),) with the priors."""
        factor, scale = self.factor(N, chosen)
        return scale * cho_solve(factor, scale * N[chosen, -1], check_finite=False)

    def factor(self, N: np.ndarray, chosen: np.ndarray) -> tuple[Factor, np.ndarray]:
        """Cholesky factor of the scaled normal matrix, and the scale; what the data do not determine is held by a ridge far below the
        rest."""
        A = N[np.ix_(chosen, chosen)]
        A[np.diag_indices_from(A)] += 1.0 / np.array(self.prior)[chosen] ** 2
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), LEAST_SQUARE))
        A *= np.outer(scale, scale)
        A[np.diag_indices_from(A)] += RIDGE
        return cho_factor(A, lower=True, check_finite=False), scale

    # errors

    def errors(self, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(J,) squared error of coefficients over all segments."""
        return np.array([self._square(j, self.total(j), chosen, x) for j in range(len(self.numbers))])

    def correlated_samples(self, chosen: np.ndarray, x: np.ndarray, least: np.ndarray) -> np.ndarray:
        """(J,) by how much the sum of the residual over a segment varies more than that of white noise: the number of samples that count
        as one, at least 1.

        least: (J,) variance of the white noise that every channel has on top. A residual that is only the rounding of the computation is
        as smooth as can be, which says nothing of the channel's noise.
        """
        white = self.count.sum(axis=0) * least
        varies = np.array([float((self._sums_of_residual(j, chosen, x) ** 2).sum()) for j in range(len(self.numbers))]) + white
        return np.maximum(varies / np.maximum(self.errors(chosen, x) + white, 1e-300), 1.0)

    def held_out(self, chosen: np.ndarray, normals: dict[int, np.ndarray]) -> np.ndarray:
        """(J,) squared errors, each fold predicted from the others (``normals``: by fold left out), the mean of each recording removed
        where that is a convention."""
        out = np.zeros(len(self.numbers))
        for fold in self.folds:
            x = self.solve(normals[fold], chosen)
            for j in range(len(self.numbers)):
                error = self._square(j, self._sum(j)[1][fold], chosen, x)
                out[j] += max(error - self._square_of_means(j, fold, chosen, x), 0.0) if self.group.refit else error
        return out

    def _square(self, j: int, products: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> float:
        """Squared error of a joint by the products (c, c) of its columns."""
        own, factor = self._residual_of_columns(j, chosen, x)
        return max(float(factor @ products[np.ix_(own, own)] @ factor), 0.0)

    def _square_of_means(self, j: int, fold: int, chosen: np.ndarray, x: np.ndarray) -> float:
        """What the mean residual of each recording adds to the squared error of a fold."""
        here = self._fold == fold
        total = np.bincount(self._run[here], self._sums_of_residual(j, chosen, x)[here])
        return float((total**2 / np.maximum(np.bincount(self._run[here], self.count[here, j]), 1.0)).sum())

    def _sums_of_residual(self, j: int, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(S,) sum of a joint's residual over each segment: its product with the offset, which is one at every sample."""
        own, factor = self._residual_of_columns(j, chosen, x)
        offset = int(np.flatnonzero(self.numbers[j] == self.offset[j])[0])
        return self.products[j][:, offset][:, own] @ factor

    def _residual_of_columns(self, j: int, chosen: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Indices (k,) of the columns of a joint of which its residual is made, the mismatch among them, and their factors (k,)."""
        at = self.positions(chosen)[self.numbers[j]]
        own = np.flatnonzero((self.numbers[j] == MISMATCH) | (at >= 0))
        return own, np.append(-x, 1.0)[at[own]]  # the mismatch is at -1

    def residual(self, j: int, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Residual (Ttot,) of a joint's mismatch; zero where a sample is not used."""
        numbers = self.numbers[j]
        own = np.flatnonzero(np.isin(numbers, chosen))
        return self.matrix[j][:, 0] - self.matrix[j][:, own] @ x[self.positions(chosen)[numbers[own]]]

    # samples

    def positions(self, chosen: np.ndarray) -> np.ndarray:
        """Position in ``chosen`` by column number, -1 for a column that is not chosen; the last entry is that of the mismatch."""
        out = np.full(len(self.prior) + 1, -1)
        out[chosen] = np.arange(len(chosen))
        return out

    def training_columns(self, j: int, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (Ttot, k) of a joint that are chosen, zero where a sample takes no part, and their positions in ``chosen``."""
        position, numbers = self.positions(chosen), self.numbers[j]
        own = np.flatnonzero((numbers >= 0) & (position[numbers] >= 0))
        return self.matrix[j][:, own] * self.training[:, None], position[numbers[own]]

    def present(self, j: int) -> np.ndarray:
        """(Ttot,) one where a sample of a joint takes part."""
        return self._use[j] * self.training

    def slices(self, run: int) -> slice:
        return slice(int(self._start[run]), int(self._start[run + 1]))
