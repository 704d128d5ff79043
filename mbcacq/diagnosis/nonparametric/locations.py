"""Locations of the cell at which an unmodelled effect may act: their components, in axes in which neighbours can be told apart.

A link's components stand in the frame of its own joint, so that turning about that joint (which is the joint's) is left out, and a
single component that is a rotation about the next joint as well is left to that joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context
from mbcacq.effects.functions import ZERO, Column, DescribedPart, scaled
from mbcacq.estimation.terms import PER_POSE, Part


@dataclass(frozen=True)
class Location:
    """name: as in the contract. keys: (place, index, component) of its unit columns; mix: (c, len(keys)), components as combinations of
    them. variants: which components may move together, each a tuple of rows of mix. frame: whose gravity moment acts here. joint: index of
    the joint there, or before it.
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

    def parts(self, rows: Sequence[int], functions: np.ndarray) -> list[Part]:
        """Some components by functions (P, f), or (M, f) of the centre, component by component."""
        moved = zip(self.keys, self.mix[list(rows)].T, strict=True)
        return [Part(*key, (mix[:, None] * functions[:, None]).reshape(len(functions), -1)) for key, mix in moved if np.any(mix)]

    def described(self, rows: Sequence[int], columns: Sequence[Column]) -> list[DescribedPart]:
        """The same by functions that are written down."""
        moved = zip(self.keys, self.mix[list(rows)].T, strict=True)
        return [
            DescribedPart(*key, tuple(scaled(f, float(m)) if m else ZERO for m in mix for f in columns)) for key, mix in moved if any(mix)
        ]


def frame(index: int) -> tuple[tuple[str, int, int], ...]:
    return tuple(("frame", index, c) for c in range(6))


SCANNER = Location("scanner", tuple(("point", 0, c) for c in range(3)), np.eye(3), ((0,), (1,), (2,), (0, 1), (0, 1, 2)))
# Several of each share their components, and differ by when, or on what, these move.
STATION = Location("station", tuple(("station", 0, c) for c in range(6)), np.eye(6), ((0, 1, 2), tuple(range(6))))
BALL = Location("ball", tuple(("ball", 0, c) for c in range(3)), np.eye(3), ((0, 1, 2),))


def of_arm(s: Context) -> list[Location]:
    """Joints, links, base and mount."""
    n = s.n
    out = [Location(f"A{i + 1}", (("joint", i, 0),), np.eye(1), ((0,),), i, i) for i in range(n)]
    chain = s.state.chain
    free = np.linalg.inv(chain.link_transforms(-chain.theta[None] * chain.sign)[:, :, :3, :3])[0]
    for i in range(1, n):
        across = free[i - 1]  # columns: axes of the frame of joint i, turned with it, in the frame behind link i
        mix = np.zeros((5, 6))
        mix[:3, :3] = across.T
        mix[3:, 3:] = across.T[:2]
        singles = [(c,) for c in range(5) if c < 3 or abs(mix[c, 5]) < OPTIONS.parallel_cosine]
        out.append(Location(f"link{i}", frame(i), mix, (*singles, (3, 4), (0, 1, 2), (0, 1, 2, 3, 4)), i, i - 1))
    whole = ((0,), (1,), (2,), (3,), (4,), (3, 4), (0, 1, 2), (3, 4, 5), tuple(range(6)))
    out.append(Location("base", frame(0), np.eye(6), whole, 0, 0))
    if s.scanner_on_flange or s.obs.rotation is not None:
        out.append(Location("mount", frame(n), np.eye(6), whole, n, n - 1))
    else:
        out.append(Location("mount", frame(n)[:3], np.eye(3), ((0,), (1,), (2,), (0, 1, 2)), n, n - 1))
    return out


def stations(s: Context) -> list[tuple[int, str]]:
    """(index of the station, name of its location) where enough was measured to see it move."""
    measured = np.unique(s.obs.station)
    enough = [int(k) for k in measured if np.sum(s.obs.station == k) > 6]
    return [(k, f"station{s.obs.cell.stations[k].id}") for k in enough] if len(measured) > 1 else []
