"""Normal equations of a group of channels, piece by piece in time: any choice of columns is fitted and tested from them alone.

A piece is half a second of a recording. Per joint and piece the products of all columns (and of the mismatch) with each other are
kept; the fit on some pieces and the squared error on others are then small matrix products, however long the recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mbcacq.diagnosis.motion.time_alignment import lateness
from mbcacq.effects.motion.effect import ChannelGroup, MotionSignals

PIECE_S = 0.5
PARTS = 3  # a single recording is held out in so many blocks
INTERLEAVED = 15  # blocks of a single recording among which effects are chosen
RIDGE = 1e-12  # of a scaled normal matrix: directions far below are not determined


@dataclass(frozen=True)
class NormalSegment:
    run: int
    where: slice
    fold: int


def parts(runs: tuple[MotionSignals, ...]) -> tuple[list[list[tuple[int, slice]]], str]:
    """What is held out in turn: whole trajectories (several at once where there are many), or blocks in time where there is only one."""
    if len(runs) > 1:
        number = min(len(runs), PARTS)
        return [[(k, slice(0, len(runs[k].q))) for k in range(f, len(runs), number)] for f in range(number)], "trajectory"
    return [[(0, block)] for block in _blocks(len(runs[0].q), PARTS)], "time block"


def _blocks(length: int, number: int) -> list[slice]:
    edges = np.linspace(0, length, number + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def pieces(runs: tuple[MotionSignals, ...], held: int | None = None) -> tuple[list[NormalSegment], str]:
    """Half seconds, and which fold they belong to while effects are chosen. held: a part that takes no part in anything.

    Folds are the trajectories that are left; of a single one, interleaved blocks.
    """
    outer, split = parts(runs)
    left = [part for i, part in enumerate(outer) if i != held]
    whole = split == "trajectory" and len(left) > 1
    out = []
    for fold, part in enumerate(left):
        for k, where in part:
            blocks = (
                [where]
                if whole
                else [
                    slice(where.start + b.start, where.start + b.stop)
                    for b in _blocks(where.stop - where.start, INTERLEAVED if split == "trajectory" else INTERLEAVED // PARTS)
                ]
            )
            for i, block in enumerate(blocks):
                number = max(int((block.stop - block.start) * runs[k].step_s / PIECE_S), 1)
                out += [
                    NormalSegment(k, slice(block.start + b.start, block.start + b.stop), fold if whole else i % PARTS)
                    for b in _blocks(block.stop - block.start, number)
                ]
    return out, split


class NormalStore:
    """Columns by number. The mismatch is column -1 of every joint; its own offset is the first column of each joint.

    held: a part of the recordings (``parts``) that takes no part in anything.
    """

    def __init__(self, group: ChannelGroup, runs: tuple[MotionSignals, ...], held: int | None = None) -> None:
        self.group, self.runs = group, runs
        self.whole = held is None
        self.pieces, self.split = pieces(runs, held)
        self.folds = sorted({p.fold for p in self.pieces})
        self._start = np.cumsum([0, *(len(r.q) for r in runs)])
        self._slices = [slice(self._start[p.run] + p.where.start, self._start[p.run] + p.where.stop) for p in self.pieces]
        self.training = np.zeros(self._start[-1])
        for piece in self._slices:
            self.training[piece] = 1.0
        self._fold = np.array([p.fold for p in self.pieces])
        self._run = np.array([p.run for p in self.pieces])
        J = range(len(group.joints))
        self._use = [np.concatenate([u[:, k] for u in group.use]).astype(float) for k in J]
        self.delay = 0.0
        self.Z = [self._mismatch(k)[:, None] for k in J]
        self.ids = [np.array([-1]) for _ in J]
        self.count = np.stack([[u[s].sum() for s in self._slices] for u in self._use], axis=1)
        self.G = [self._products(z, z) for z in self.Z]
        self._sums: list[dict[int, np.ndarray] | None] = [None for _ in J]
        self.prior: list[float] = []
        offsets = [self.add([k], [np.ones((len(self.Z[k]), 1))]) for k in J]
        self.offset = [int(o[0]) for o in offsets]
        self.base = np.array(self.offset)
        if group.base[0].shape[2]:
            columns = [np.concatenate([b[:, k] for b in group.base]) for k in J]
            self.base = np.concatenate([self.base, self.add(list(J), columns, group.prior)])

    def add(self, places: list[int], columns: list[np.ndarray], prior: np.ndarray | None = None) -> np.ndarray:
        """New columns (Ttot, k) for each of the joints at ``places``, with common coefficients. Returns their numbers (k,)."""
        k = columns[0].shape[1]
        new = len(self.prior) + np.arange(k)
        self.prior += [np.inf] * k if prior is None else list(prior)
        for place, column in zip(places, columns, strict=True):
            fresh = column * self._use[place][:, None]
            cross, own = self._products(self.Z[place], fresh), self._products(fresh, fresh)
            old = self.G[place]
            self.G[place] = np.concatenate(
                [np.concatenate([old, cross], axis=2), np.concatenate([np.swapaxes(cross, 1, 2), own], axis=2)], axis=1
            )
            self.Z[place] = np.concatenate([self.Z[place], fresh], axis=1)
            self.ids[place] = np.concatenate([self.ids[place], new])
            self._sums[place] = None
        return new

    def _mismatch(self, place: int) -> np.ndarray:
        out = np.concatenate([m[:, place] for m in self.group.mismatch])
        if self.delay != 0.0:
            out = out + np.concatenate([lateness(self.group, r, k, place, self.delay) for k, r in enumerate(self.runs)])
        return out * self._use[place]

    def retime(self, delay: float) -> None:
        """Move the recorded channel of all joints forward by so many s, from where it was recorded."""
        if delay == self.delay:
            return
        self.delay = delay
        for place in range(len(self.Z)):
            self._put(place, [0], self._mismatch(place)[:, None])

    def replace(self, numbers: np.ndarray, places: list[int], columns: list[np.ndarray]) -> None:
        """Other columns (Ttot, k) for each of the joints at ``places`` instead of those numbered so."""
        for place, column in zip(places, columns, strict=True):
            at = [int(np.flatnonzero(self.ids[place] == i)[0]) for i in numbers]
            self._put(place, at, column * self._use[place][:, None])

    def _put(self, place: int, at: list[int], fresh: np.ndarray) -> None:
        self.Z[place][:, at] = fresh
        cross = self._products(self.Z[place], fresh)
        self.G[place][:, :, at], self.G[place][:, at, :] = cross, np.swapaxes(cross, 1, 2)
        self._sums[place] = None

    def add_many(self, batches: list[tuple[int, np.ndarray]], sigmas: list[np.ndarray]) -> list[np.ndarray]:
        """Columns (Ttot, k) of single joints, (place, columns) each with their priors (k,); faster than one by one. Returns their
        numbers."""
        out: list[np.ndarray] = [np.zeros(0, dtype=int)] * len(batches)
        for place in range(len(self.Z)):
            mine = [i for i, (p, _) in enumerate(batches) if p == place]
            if mine:
                numbers = self.add(
                    [place], [np.concatenate([batches[i][1] for i in mine], axis=1)], np.concatenate([sigmas[i] for i in mine])
                )
                for i, part in zip(mine, np.split(numbers, np.cumsum([batches[i][1].shape[1] for i in mine])[:-1]), strict=True):
                    out[i] = part
        return out

    def forget(self, mark: int) -> None:
        """Drop all columns numbered ``mark`` and higher."""
        del self.prior[mark:]
        for k, ids in enumerate(self.ids):
            mask = ids < mark
            if not mask.all():
                self.ids[k], self.Z[k], self.G[k] = ids[mask], self.Z[k][:, mask], self.G[k][:, mask][:, :, mask]
                self._sums[k] = None

    def _sum(self, place: int, fold: int | None) -> np.ndarray:
        """Products over all pieces, or over a fold."""
        if self._sums[place] is None:
            parts = {f: self.G[place][self._fold == f].sum(axis=0) for f in self.folds}
            self._sums[place] = parts | {-1: sum(parts.values())}
        return self._sums[place][-1 if fold is None else fold]

    def _products(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(pieces, a, b) sums over each piece."""
        return np.stack([left[s].T @ right[s] for s in self._slices])

    def columns(self, candidate, joint: int, hyper) -> np.ndarray:
        """(Ttot, k) of an effect at one joint."""
        return np.concatenate([candidate.columns(r, joint, hyper) for r in self.runs])

    def candidate(self, candidate, hyper) -> np.ndarray:
        places = [self.group.joints.index(j) for j in candidate.joints]
        columns = [self.columns(candidate, j, hyper) for j in candidate.joints]
        return self.add(places, columns, np.broadcast_to(candidate.sigma, columns[0].shape[1]))

    def normal(self, weights: np.ndarray, without: int | None = None) -> np.ndarray:
        """(P + 1, P + 1) weighted normal matrix of all columns, mismatch last; without: a fold left out."""
        P = len(self.prior)
        N = np.zeros((P + 1, P + 1))
        for k, ids in enumerate(self.ids):
            at = np.where(ids < 0, P, ids)
            N[np.ix_(at, at)] += weights[k] * (self._sum(k, None) if without is None else self._sum(k, None) - self._sum(k, without))
        return N

    def solve(self, N: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Coefficients (len(chosen),) with the priors."""
        factor, scale = self.factor(N, chosen)
        return scale * cho_solve(factor, scale * N[chosen, -1], check_finite=False)

    def strain(self, chosen: np.ndarray, x: np.ndarray) -> float:
        """How far the coefficients are from what is known of them beforehand, in squared sigmas."""
        return float(((x / np.array(self.prior)[chosen]) ** 2).sum())

    def factor(self, N: np.ndarray, chosen: np.ndarray) -> tuple[tuple, np.ndarray]:
        """Cholesky factor of the scaled normal matrix; what the data do not determine is held by a ridge far below the rest."""
        A = N[np.ix_(chosen, chosen)]
        A[np.diag_indices_from(A)] += 1.0 / np.array(self.prior)[chosen] ** 2
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        A *= np.outer(scale, scale)
        A[np.diag_indices_from(A)] += RIDGE
        return cho_factor(A, lower=True, check_finite=False), scale

    def errors(self, chosen: np.ndarray, x: np.ndarray, fold: int | None = None) -> np.ndarray:
        """Squared error (pieces, J) of coefficients on the pieces of a fold (all if None), its mean taken out where that is convention."""
        take = np.ones(len(self.pieces), dtype=bool) if fold is None else self._fold == fold
        position = np.full(len(self.prior) + 1, -1)
        position[chosen] = np.arange(len(chosen))
        out = np.empty((int(take.sum()), len(self.ids)))
        runs = self._run[take]
        for k, ids in enumerate(self.ids):
            mine = np.flatnonzero((ids < 0) | (position[ids] >= 0))
            v = np.array([1.0 if i < 0 else -x[position[i]] for i in ids[mine]])
            G = self.G[k] if fold is None else self.G[k][take]
            if 2 * len(mine) < len(ids):
                Gv = G[:, mine][:, :, mine] @ v
            else:
                full = np.zeros(len(ids))
                full[mine] = v
                Gv = (G @ full)[:, mine]
            square = Gv @ v
            if self.group.refit and fold is not None:
                first = int(np.flatnonzero(ids[mine] == self.offset[k])[0])
                total, n = Gv[:, first], self.count[take, k]
                for run in np.unique(runs):
                    same = runs == run
                    mean = total[same].sum() / max(n[same].sum(), 1.0)
                    square[same] += -2.0 * mean * total[same] + n[same] * mean**2
            out[:, k] = np.maximum(square, 0.0)
        return out

    def held_out(self, weights: np.ndarray, chosen: np.ndarray, normals: dict[int, np.ndarray]) -> np.ndarray:
        """Squared errors (pieces, J), each fold predicted from the others; pieces ordered by fold."""
        return np.concatenate([self.errors(chosen, self.solve(normals[f], chosen), f) for f in self.folds])

    @property
    def held_count(self) -> np.ndarray:
        return np.concatenate([self.count[self._fold == f] for f in self.folds])

    def residual(self, place: int, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        """What is left (Ttot,) of a joint's mismatch; zero where a sample is not used."""
        ids = self.ids[place]
        mine = np.flatnonzero(np.isin(ids, chosen))
        order = {c: i for i, c in enumerate(chosen)}
        return self.Z[place][:, 0] - self.Z[place][:, mine] @ x[[order[i] for i in ids[mine]]]

    def scores(self, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(pieces, c): what is left, weighted, times each column, summed over each piece."""
        scores = np.zeros((len(self.pieces), len(chosen)))
        position = np.full(len(self.prior) + 1, -1)
        position[chosen] = np.arange(len(chosen))
        for k, ids in enumerate(self.ids):
            mine = np.flatnonzero((ids >= 0) & (position[ids] >= 0))
            full = np.zeros(len(ids))
            full[mine], full[ids < 0] = -x[position[ids[mine]]], 1.0
            scores[:, position[ids[mine]]] += weights[k] * (self.G[k] @ full)[:, mine]
        return scores

    def covariance(self, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Of the coefficients: from pieces taken as independent (sandwich), never less than for white noise."""
        factor, scale = self.factor(self.normal(weights), chosen)
        inverse = cho_solve(factor, np.eye(len(chosen)), check_finite=False) * np.outer(scale, scale)
        scores = self.scores(weights, chosen, x)
        n = len(scores)
        meat = scores.T @ scores * n / max(n - 1, 1)
        robust = inverse @ meat @ inverse
        white = inverse * max(float((self.errors(chosen, x) @ weights).sum()) / max(self.count.sum() - len(chosen), 1.0), 1e-300)
        least = np.diag(white)
        known = np.maximum(np.diag(robust), 1e-9 * least + 1e-300)
        grow = np.sqrt(np.maximum(least / known, 1.0))
        return robust * np.outer(grow, grow) + np.diag(np.maximum(least - np.diag(robust) * grow**2, 0.0))

    def taking_part(self, place: int, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (Ttot, k) of a joint that are chosen, zero where a sample takes no part, and where they stand in ``chosen``."""
        position = np.full(len(self.prior) + 1, -1)
        position[chosen] = np.arange(len(chosen))
        ids = self.ids[place]
        mine = np.flatnonzero((ids >= 0) & (position[ids] >= 0))
        return self.Z[place][:, mine] * self.training[:, None], position[ids[mine]]

    def present(self, place: int) -> np.ndarray:
        """(Ttot,) one where a sample of a joint takes part."""
        return self._use[place] * self.training

    def slices(self, run: int) -> slice:
        return slice(int(self._start[run]), int(self._start[run + 1]))


def third_difference_noise(signals: tuple[np.ndarray, ...]) -> float:
    """Standard deviation of white noise on smooth signals (T,), from their third differences."""
    third = np.concatenate([np.diff(m, 3) for m in signals])
    return max(float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)), 1e-12)
