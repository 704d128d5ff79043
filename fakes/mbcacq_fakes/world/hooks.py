"""Where injected effects may act.

An effect is any object with the methods of ``WorldEffect``; the world calls them in time order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mbcacq_fakes.world.arm import TrueArm
from mbcacq_fakes.world.description import CellFacts


@dataclass(frozen=True)
class Moments:
    """P moments in time order. q, velocity: (P, n) as reported, rad, rad/s. direction: (P, n) -1, 0, 1, direction of each axis' last
    motion. arrival: (P,) how many standstills were reached before. time_s: (P,) since the cell was switched on. air_C, robot_C:
    (P,). station, artefact: (P,) index of the station aimed at and of the artefact that stands there (-1: none).
    """

    q: np.ndarray
    velocity: np.ndarray
    direction: np.ndarray
    arrival: np.ndarray
    time_s: np.ndarray
    air_C: np.ndarray
    robot_C: np.ndarray
    station: np.ndarray
    artefact: np.ndarray

    def __len__(self) -> int:
        return len(self.q)


@dataclass
class Moved:
    """What effects add up, all zero at first. joint (P, n) rad on top of the reported angle; frame (P, n + 1, 6) shift mm and
    rotation vector rad of each frame in itself (0 the base, n the mount); station (P, 6) the same of the artefact's
    placement; ball (P, K, 3) mm in the artefact's frame, K over all balls of the cell.
    """

    joint: np.ndarray
    frame: np.ndarray
    station: np.ndarray
    ball: np.ndarray

    @classmethod
    def nothing(cls, poses: int, axes: int, balls: int) -> Moved:
        return cls(np.zeros((poses, axes)), np.zeros((poses, axes + 1, 6)), np.zeros((poses, 6)), np.zeros((poses, balls, 3)))


class WorldEffect(Protocol):
    name: str

    def alter(self, cell: CellFacts) -> CellFacts:
        """What is true of the cell in place of what is believed, e.g. another payload; called before any ``begin``."""
        ...

    def begin(self, cell: CellFacts, arm: TrueArm, rng: np.random.Generator) -> None:
        """Called once before the first moment; draws what is to be drawn. ``arm`` is the true arm."""

    def displace(self, at: Moments, moved: Moved) -> None:
        """Add to ``moved``. Moments come in time order over all calls, each once an exposure, so an effect may keep a state."""

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        """What the scanner reports for true points (N, 3) mm in its frame; ``pose`` (N,) indexes the moments."""
        ...

    def truth(self) -> dict[str, Any]:
        """The drawn parameters under the names of the observation-set contract, and 'where'."""
        ...


class NoEffect:
    """Base of effects: does nothing anywhere."""

    name = "nothing"

    def alter(self, cell: CellFacts) -> CellFacts:
        return cell

    def begin(self, cell: CellFacts, arm: TrueArm, rng: np.random.Generator) -> None:
        self.cell, self.arm, self.rng = cell, arm, rng

    def displace(self, at: Moments, moved: Moved) -> None:
        pass

    def warp(self, points: np.ndarray, pose: np.ndarray, at: Moments) -> np.ndarray:
        return points

    def truth(self) -> dict[str, Any]:
        return {}
