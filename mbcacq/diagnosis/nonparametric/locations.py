"""Locations of the cell at which an unmodelled effect may act: their components, in axes in which neighbours can be told apart.

A link's components stand in the frame of its own joint, so that turning about that joint (which is the joint's) is left out. A single
component that is a rotation about the next joint as well is left to that joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context
from mbcacq.effects.functions import ZERO, Column, DescribedPart, scaled
from mbcacq.estimation.terms import PER_POSE


@dataclass(frozen=True)
class Location:
    """Where an unmodelled effect can act.

    Attributes
    ----------
    name : str
        Name as in the contract.
    keys : tuple[tuple[str, int, int], ...]
        (place, index, component) of its unit columns.
    mix : ndarray
        (c, len(keys)), components as combinations of them.
    variants : tuple[tuple[int, ...], ...]
        Components that may move together, each a tuple of rows of mix.
    frame : int
        The frame whose gravity moment acts here.
    joint : int
        Index of the joint there, or before it.
    """

    name: str
    keys: tuple[tuple[str, int, int], ...]
    mix: np.ndarray
    variants: tuple[tuple[int, ...], ...]
    frame: int = 0
    joint: int = 0

    @property
    def per_pose(self) -> bool:
        """Whether it moves a pose as a whole, by functions of the pose; else single centres, by functions of the centre."""
        return self.keys[0][0] in PER_POSE

    def described(self, rows: Sequence[int], columns: Sequence[Column]) -> list[DescribedPart]:
        """Some components by functions of the pose, or of the centre, component by component."""
        moved = zip(self.keys, self.mix[list(rows)].T, strict=True)
        return [
            DescribedPart(*key, tuple(scaled(f, float(m)) if m else ZERO for m in mix for f in columns)) for key, mix in moved if any(mix)
        ]


def components(place: str, index: int = 0, count: int = 6) -> tuple[tuple[str, int, int], ...]:
    return tuple((place, index, c) for c in range(count))


def scanner() -> Location:
    """The measured point, in the frame of the instrument."""
    return Location("scanner", components("point", count=3), np.eye(3), ((0,), (1,), (2,), (0, 1), (0, 1, 2)))


def of_arm(s: Context) -> list[Location]:
    """Joints, links, base and mount."""
    n = s.n
    out = [Location(f"A{i + 1}", components("joint", i, 1), np.eye(1), ((0,),), i, i) for i in range(n)]
    chain = s.state.chain
    free = np.linalg.inv(chain.link_transforms(-chain.theta[None] * chain.sign)[:, :, :3, :3])[0]
    shifts, turns = ((0,), (1,), (2,), (0, 1, 2)), ((3,), (4,), (3, 4))
    for i in range(1, n):
        across = free[i - 1]  # columns: axes of the frame of joint i, turned with it, in the frame behind link i
        mix = np.zeros((5, 6))
        mix[:3, :3] = across.T
        mix[3:, 3:] = across.T[:2]
        own = [rows for rows in turns if len(rows) > 1 or np.hypot(*mix[rows[0], 3:5]) > OPTIONS.varies]
        out.append(Location(f"link{i}", components("frame", i), mix, (*shifts, *own, (0, 1, 2, 3, 4)), i, i - 1))
    six = (*shifts, *turns, (3, 4, 5), tuple(range(6)))
    out.append(Location("base", components("frame", 0), np.eye(6), six, 0, 0))
    turned = s.scanner_on_flange or s.obs.rotation is not None
    whole = (np.eye(6), six) if turned else (np.eye(3), shifts)
    return [*out, Location("mount", components("frame", n, len(whole[0])), *whole, n, n - 1)]
