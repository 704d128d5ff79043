"""Whitened columns, their products over the poses that are asked for, and the posterior of their coefficients by these products.

Wide groups of columns are never written out.

A group for an unmodelled effect of a joint has more than a hundred functions of the joint's angle, and all of them move a pose in the same
direction. With u the whitened displacement of a pose by a unit of it and F (P, k) the functions, its columns are u F, and their products
with other columns are sums over poses of F by one number for each pose: a sixth of the work where a pose has six rows, and of the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve, cholesky

from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.normal_equations import inverse_of_lower
from mbcacq.estimation.terms import PER_POSE, Part
from mbcacq.estimation.whitening import CentreWhitening

WIDE = 24  # functions of one displacement from which its columns are not written out
AT_ONCE = 4096  # rows of a part of the poses that are copied


@dataclass(frozen=True)
class ColumnProducts:
    """Products over some centres: information (z, z) those of the columns, right (z,) with the residual, square of it; whitened."""

    information: np.ndarray
    right: np.ndarray
    square: float

    def __add__(self, other: ColumnProducts) -> ColumnProducts:
        """The products over these centres and others."""
        return ColumnProducts(self.information + other.information, self.right + other.right, self.square + other.square)

    def of_columns(self, index: np.ndarray) -> ColumnProducts:
        """The products of some of the columns."""
        return ColumnProducts(self.information[np.ix_(index, index)], self.right[index], self.square)


class WhitenedColumns:
    """The columns (z) of a linearised recording, those given first, then group by group.

    written: (M R, N) whitened, those that are written out, the residual last. index: (z,) place of every column among all written ones and,
    after these, the wide ones.
    """

    def __init__(self, linear: LinearProblem, whiten: CentreWhitening, given: np.ndarray, groups: Sequence[Sequence[Part]]):
        """given: (M, R, n) columns; groups: parts of each further group of columns."""
        self._obs, self._width, self._whiten = linear.obs, linear.width, whiten
        self._wide = [parts[0] for parts in groups if is_wide(parts)]
        self.index = _places(given.shape[2], groups)
        narrow = [parts for parts in groups if not is_wide(parts)]
        ends = given.shape[2] + np.cumsum([0] + [parts[0].basis.shape[1] for parts in narrow])
        self.written = np.empty((linear.residual.size, ends[-1] + 1))
        self.written[:, : ends[0]] = whiten(given)
        for parts, start, end in zip(narrow, ends[:-1], ends[1:], strict=True):
            self._write(linear, parts, self.written[:, start:end])
        self.written[:, -1] = whiten(linear.residual)
        if self._wide:
            self._units = whiten(np.stack([linear.unit(p.place, p.index, p.component) for p in self._wide], axis=2))
            self._among = whiten.pose_products(self._units, self._units)

    def _write(self, linear: LinearProblem, parts: Sequence[Part], out: np.ndarray) -> None:
        """The columns of a narrow group (M R, k). A function of the pose is a factor of the pose's whitened rows."""
        if any(p.place not in PER_POSE for p in parts):
            out[:] = self._whiten(linear.columns(parts))
            return
        units = self._whiten(np.stack([linear.unit(p.place, p.index, p.component) for p in parts], axis=2))
        out[:] = 0.0
        by_centre, rows = out.reshape(*linear.residual.shape, -1), units.reshape(*linear.residual.shape, -1)
        for j, part in enumerate(parts):
            for column in np.flatnonzero(part.basis.any(axis=0)):
                by_centre[:, :, column] += rows[:, :, j] * part.basis[self._obs.pose, column, None]

    def with_change(self, own: slice, change: np.ndarray) -> WhitenedColumns:
        """The same where some of the columns that were given are more by these (M R, k), whitened."""
        out = copy(self)
        out.written = self.written.copy()
        out.written[:, own] += change
        return out

    def products(self, poses: np.ndarray | None = None) -> ColumnProducts:
        """The products over the centres of these poses, (P,) bool, or over all."""
        return self.products_of_parts([np.ones(self._obs.n_poses, bool) if poses is None else poses])[0]

    def products_of_parts(self, parts: Sequence[np.ndarray]) -> list[ColumnProducts]:
        """The same over each of some parts of the poses, (P,) bool."""
        N = self.written.shape[1]
        totals = [np.empty((N + sum(p.basis.shape[1] for p in self._wide),) * 2) for _ in parts]
        for total, part in zip(totals, parts, strict=True):
            total[:N, :N] = self._square_of(None if part.all() else np.repeat(part[self._obs.pose], self._width))
        self._add_wide(totals, parts)
        last, index = N - 1, self.index
        return [ColumnProducts(total[np.ix_(index, index)], total[last, index], float(total[last, last])) for total in totals]

    def _square_of(self, rows: np.ndarray | None) -> np.ndarray:
        """(N, N): products over some rows (M R,) bool, copied some at a time; None: over all."""
        if rows is None:
            return self.written.T @ self.written
        chosen, size = np.flatnonzero(rows), self.written.shape[1]
        total = np.zeros((size, size))
        for start in range(0, len(chosen), AT_ONCE):
            some = self.written[chosen[start : start + AT_ONCE]]
            total += some.T @ some
        return total

    def _add_wide(self, totals: Sequence[np.ndarray], parts: Sequence[np.ndarray]) -> None:
        N = self.written.shape[1]
        ends = N + np.cumsum([0] + [p.basis.shape[1] for p in self._wide])
        for i, wide in enumerate(self._wide):
            own = slice(ends[i], ends[i + 1])
            by_pose = self._whiten.pose_products(self._units[:, i, None], self.written)[:, 0]
            for total, part in zip(totals, parts, strict=True):
                F = wide.basis[part]
                total[own, :N] = F.T @ by_pose[part]
                total[:N, own] = total[own, :N].T
                for j, other in enumerate(self._wide[: i + 1]):
                    there = slice(ends[j], ends[j + 1])
                    total[own, there] = F.T @ (self._among[part, i, j, None] * other.basis[part])
                    total[there, own] = total[own, there].T


def _places(given: int, groups: Sequence[Sequence[Part]]) -> np.ndarray:
    """(z,) place of every column: of those given, then group by group; the wide ones after the residual."""
    widths = [parts[0].basis.shape[1] for parts in groups]
    narrow, places = given, [np.arange(given)]
    wide = given + sum(k for k, parts in zip(widths, groups, strict=True) if not is_wide(parts)) + 1
    for k, parts in zip(widths, groups, strict=True):
        if is_wide(parts):
            places.append(np.arange(wide, wide + k))
            wide += k
        else:
            places.append(np.arange(narrow, narrow + k))
            narrow += k
    return np.concatenate(places)


def is_wide(parts: Sequence[Part]) -> bool:
    """Whether the columns of a group stay what they are made of."""
    return len(parts) == 1 and parts[0].place in PER_POSE and parts[0].basis.shape[1] >= WIDE


@dataclass(frozen=True)
class Posterior:
    """sigma: prior of the coefficients (z,). seen: products of the centres that are given, without the prior."""

    sigma: np.ndarray
    seen: ColumnProducts

    @cached_property
    def root(self) -> np.ndarray:
        """(z, z) lower root of the normal matrix in units of sigma, prior included."""
        return root_of(self.sigma, self.seen.information)

    @cached_property
    def solution(self) -> np.ndarray:
        return self.sigma * self.solved(self.sigma * self.seen.right)

    def solved(self, right: np.ndarray) -> np.ndarray:
        """The inverse of the normal matrix times right (z,) or (z, k), in units of sigma."""
        return cho_solve((self.root, True), right, check_finite=False)

    def covariance_of(self, index: np.ndarray) -> np.ndarray:
        """(k, k) of the coefficients at index (k,)."""
        unit = np.zeros((len(self.sigma), len(index)))
        unit[index, np.arange(len(index))] = self.sigma[index]
        return self.sigma[index, None] * self.solved(unit)[index]

    @property
    def determined(self) -> float:
        """Number of coefficients that the centres determine: what is not known of the others is their prior."""
        half = inverse_of_lower(self.root)
        return float(len(self.sigma) - np.sum(half * half))

    def predicted(self, other: ColumnProducts) -> float:
        """chi2 of other centres about their prediction, under the covariance of noise and prediction together."""
        both = root_of(self.sigma, self.seen.information + other.information)
        right = self.sigma * (self.seen.right + other.right)
        return float(other.square - right @ cho_solve((both, True), right, check_finite=False) + self.seen.right @ self.solution)


def root_of(sigma: np.ndarray, information: np.ndarray) -> np.ndarray:
    """(z, z) lower root of a normal matrix with a prior, in units of its sigma (z,)."""
    normal = sigma[:, None] * information * sigma
    normal[np.diag_indices_from(normal)] += 1.0
    return cholesky(normal, lower=True, overwrite_a=True, check_finite=False)
