"""Backward elimination of poses: from all of them the one is left out that is missed least, again and again.

Growing one by one would never open a station: the first pose there is spent on finding the artefact. The rest at any moment is nested in
the rest before, so one pass gives the best few of every number.

With all of a set measured, effects have beyond the geometry the normal matrix E'E - E'Z N^-1 Z'E, N = I + Z'Z. Without pose i it is smaller
by e_i' (I - H_i)^-1 e_i, where e_i = E_i - Z_i N^-1 Z'E and H_i = Z_i N^-1 Z_i'.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.design.information_blocks import InformationBlocks

SIX = 6  # parameters of the place of a station
LEAST_LEFT = 1e-9  # of the information of a pose that the others have as well: rounding


@dataclass(frozen=True, eq=False)
class MeasuredInformation:
    """The information that is known already. N (G, G) information of the geometry with its prior, B (G, K) = Z'E and products (K, K) =
    E'E."""

    N: np.ndarray
    B: np.ndarray
    products: np.ndarray

    def of_block(self, g: int, block: slice) -> MeasuredInformation:
        """The same information of the first g parameters and one block of six of a station alone, all other stations at their best places.
        Rows of one station say nothing about another, so their blocks are independent, given the first g.
        """
        N_others, B_others, products_others = self._eliminated(g)
        own = (block.start - g) // SIX
        keep = np.r_[np.arange(g), np.arange(block.start, block.stop)]
        N, B = self.N[np.ix_(keep, keep)].copy(), self.B[keep].copy()
        N[:g, :g] -= N_others[own]
        B[:g] -= B_others[own]
        return MeasuredInformation(N, B, self.products - products_others[own])

    def _eliminated(self, g: int) -> tuple[np.ndarray, ...]:
        """By how much information of the first g parameters (S, g, g), (S, g, K) and of the effects (S, K, K) is smaller with the places of
        all stations but each free.
        """
        if g not in self._by_station:
            across = self.N[g:, :g].reshape(-1, SIX, g)
            effects = self.B[g:].reshape(len(across), SIX, -1)
            own = (
                np.stack([self.N[k : k + SIX, k : k + SIX] for k in range(g, len(self.N), SIX)]) if len(across) else np.zeros((0, SIX, SIX))
            )
            solved = np.linalg.solve(own, np.concatenate([across, effects], axis=2))
            toward = np.swapaxes(across, 1, 2)
            whole = toward @ solved
            each = whole[:, :, :g], whole[:, :, g:], np.swapaxes(effects, 1, 2) @ solved[:, :, g:]
            self._by_station[g] = tuple(one.sum(axis=0) - one for one in each)
        return self._by_station[g]

    @cached_property
    def _by_station(self) -> dict[int, tuple[np.ndarray, ...]]:
        return {}

    @classmethod
    def nothing(cls, G: int, K: int) -> MeasuredInformation:
        return cls(np.eye(G), np.zeros((G, K)), np.zeros((K, K)))

    def with_poses(self, blocks: InformationBlocks) -> MeasuredInformation:
        """The same with the poses of the blocks measured as well."""
        Z, E = blocks.Z.reshape(-1, blocks.Z.shape[2]), blocks.E.reshape(-1, blocks.E.shape[2])
        return MeasuredInformation(self.N + Z.T @ Z, self.B + Z.T @ E, self.products + E.T @ E)

    def variance(self, J: np.ndarray) -> float:
        """Sum of the variances of J (m, G) times the parameters of the geometry."""
        return float(np.sum(J * np.linalg.solve(self.N, J.T).T)) if len(J) else 0.0

    @cached_property
    def gram(self) -> np.ndarray:
        """(K, K) of the effects beyond the geometry."""
        return self.products - self.B.T @ np.linalg.solve(self.N, self.B)

    @property
    def squares(self) -> np.ndarray:
        """(K,) information of each effect by itself."""
        return np.diag(self.gram)


class BackwardElimination:
    """Poses that are left, and what each of them is missed by. pairs: number of first effects whose whole products are kept; only squares
    are kept for the others.
    """

    def __init__(self, before: MeasuredInformation, blocks: InformationBlocks, pairs: int):
        self.blocks, self.pairs = blocks, pairs
        self.left = np.ones(len(blocks.Z), dtype=bool)
        whole = before.with_poses(blocks)
        scale = 1.0 / np.sqrt(np.diag(whole.N))  # of units as different as metres and their prior in micrometres
        self._C = np.linalg.inv(whole.N * np.outer(scale, scale)) * np.outer(scale, scale)
        self._e = blocks.E - blocks.Z @ (self._C @ whole.B)
        self._H = blocks.Z @ self._C @ np.swapaxes(blocks.Z, 1, 2)
        gram = whole.gram
        self.products, self.squares = gram[:pairs, :pairs].copy(), np.diag(gram).copy()

    def missed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices (n,) of the poses that are left, and by how much products (n, pairs, pairs) and squares (n, K) are smaller without
        each.
        """
        index = np.flatnonzero(self.left)
        t = self._whitening(self._H[index]) @ self._e[index]
        some = t[:, :, : self.pairs]
        return index, np.swapaxes(some, 1, 2) @ some, np.sum(t * t, axis=1)

    def variance(self, J: np.ndarray) -> float:
        """Sum of the variances of J (m, G) times the parameters of the geometry."""
        return float(np.sum(J @ self._C * J))

    def variance_without(self, J: np.ndarray) -> np.ndarray:
        """(n,) the same without each of the poses that are left."""
        index = np.flatnonzero(self.left)
        toward = self._whitening(self._H[index]) @ (self.blocks.Z[index] @ (self._C @ J.T))
        return self.variance(J) + np.sum(toward * toward, axis=(1, 2))

    def remove(self, pose: int) -> None:
        """Leave a pose out."""
        Z, e = self.blocks.Z[pose], self._e[pose]
        whitening = self._whitening(self._H[pose])
        t = whitening @ e
        self.products -= t[:, : self.pairs].T @ t[:, : self.pairs]
        self.squares -= np.sum(t * t, axis=0)
        toward = whitening @ (Z @ self._C)  # (r, G)
        self.left[pose] = False
        shared = self.blocks.Z @ toward.T  # (P, r, r)
        self._e += shared @ t
        self._H += shared @ np.swapaxes(shared, 1, 2)
        self._C += toward.T @ toward

    @staticmethod
    def _whitening(H: np.ndarray) -> np.ndarray:
        """W (..., r, r) with W'W = (I - H)^-1; what a pose alone determines has H of one, and is kept finite."""
        value, vectors = np.linalg.eigh(np.eye(H.shape[-1]) - H)
        return np.swapaxes(vectors, -1, -2) / np.sqrt(np.maximum(value, LEAST_LEFT))[..., None]

    def __iter__(self) -> Iterator[int]:
        return iter(np.flatnonzero(self.left).tolist())
