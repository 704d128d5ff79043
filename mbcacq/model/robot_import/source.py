"""An arm as its source describes it, before it becomes MD-H rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass
class ArmSource:
    """Everything at joint positions of zero, in the base frame that was named; lengths in mm, angles in rad, masses in kg.

    joints: names, base first; sliding: numbers of the prismatic ones; follows: number, leader and ratio of those that others move.
    direction, point: (n, 3) of each joint's axis. T_base_flange: (4, 4). limits: (n, 2), nan where the source
    has none. speed: (n,) rad/s, nan likewise. mass (n,), com (n, 3): of what moves with each joint. forward: T_base_flange (P, 4, 4) of
    joint angles q (P, n) by the source's own reckoning, to compare with. remarks: sentences for the one who imports.
    """

    name: str
    base: str
    flange: str
    joints: Sequence[str]
    direction: np.ndarray
    point: np.ndarray
    T_base_flange: np.ndarray
    limits: np.ndarray
    speed: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    forward: Callable[[np.ndarray], np.ndarray]
    remarks: list[str] = field(default_factory=list)
    acceleration: np.ndarray | None = None
    sliding: tuple[int, ...] = ()
    follows: tuple[tuple[int, int, float], ...] = ()
