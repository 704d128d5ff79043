"""Whitened columns and their products, over the poses that are asked for; wide groups of columns are never written out.

A group for an unmodelled effect of a joint has more than a hundred functions of the joint's angle, and all of them move a pose in the same
direction. With u the whitened displacement of a pose by a unit of it and F (P, k) the functions, its columns are u F, and their products
with other columns are sums over poses of F by one number for each pose: a sixth of the work where a pose has six rows, and of the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import PER_POSE, Part
from mbcacq.estimation.whitening import CentreWhitening

WIDE = 24  # functions of one displacement from which its columns are not written out


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
            self._by_pose = whiten.pose_products(self._units, self.written)
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
        if self._wide:
            out._by_pose = self._by_pose.copy()
            out._by_pose[:, :, own] += self._whiten.pose_products(self._units, change)
        return out

    def products(self, poses: np.ndarray | None = None) -> ColumnProducts:
        """The products over the centres of these poses, (P,) bool, or over all."""
        chosen: slice | np.ndarray = slice(None) if poses is None else poses
        written = self.written if poses is None else self.written[np.repeat(poses[self._obs.pose], self._width)]
        N = written.shape[1]
        total = np.empty((N + sum(p.basis.shape[1] for p in self._wide),) * 2)
        total[:N, :N] = written.T @ written
        if self._wide:
            self._add_wide(total, N, chosen)
        last, index = N - 1, self.index
        return ColumnProducts(total[np.ix_(index, index)], total[last, index], float(total[last, last]))

    def _add_wide(self, total: np.ndarray, N: int, chosen: slice | np.ndarray) -> None:
        functions = [p.basis[chosen] for p in self._wide]
        ends = N + np.cumsum([0] + [F.shape[1] for F in functions])
        by_pose, among = self._by_pose[chosen], self._among[chosen]
        for i, F in enumerate(functions):
            own = slice(ends[i], ends[i + 1])
            total[own, :N] = F.T @ by_pose[:, i]
            total[:N, own] = total[own, :N].T
            for j, other in enumerate(functions[: i + 1]):
                there = slice(ends[j], ends[j + 1])
                total[own, there] = F.T @ (among[:, i, j, None] * other)
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
