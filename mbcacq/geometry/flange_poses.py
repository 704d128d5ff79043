"""Poses of the flange in place of joint angles, as an arm of six coordinates: three displacements and a rotation vector.

An arm of which only ``T_base_flange`` is known has no links to identify; its hand-eye transform can still be found. The poses that a
controller reports repeat, and are off, along and about the axes of the base: these six take the place of the joints in the noise.
"""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain, rotation_twist

SIZE = 6
LEVER_MM = 500.0  # at which the rotation of a pose counts as much as its displacement: half of the reach of an arm of middle size
NOMINAL_PER_REPEATABILITY = 10.0  # pose accuracy over pose repeatability (ISO 9283: AP, RP) of arms as they are delivered


class FlangePoses(Chain):
    """q (P, 6): x, y, z in mm and the rotation vector in rad of T_base_flange. All rows of the chain are zero, none can be free."""

    @classmethod
    def new(cls) -> FlangePoses:
        """The only one there is."""
        return cls(np.ones(SIZE), *np.zeros((5, SIZE)))

    @property
    def lever(self) -> np.ndarray:
        return np.array([1.0, 1.0, 1.0, LEVER_MM, LEVER_MM, LEVER_MM])

    def expected_noise(self, repeatability_mm: float) -> np.ndarray:
        """(6,) mm and rad: the errors of the links, of which nothing is known here, are noise of the poses."""
        return NOMINAL_PER_REPEATABILITY * super().expected_noise(repeatability_mm)

    def drawn_between(self, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high = limits.T
        return low, high

    def parallel_next(self, tolerance: float = 1e-6) -> np.ndarray:
        return np.zeros(SIZE, dtype=bool)

    def redundant(self, base_known: bool = False, tolerance: float = 1e-6) -> np.ndarray:
        return np.ones((SIZE, 5), dtype=bool)

    def frames(self, q: np.ndarray, displacement: np.ndarray | None = None) -> np.ndarray:
        """(P, 7, 4, 4): [:, 6] is the flange, the others stay at the base."""
        out = np.empty((len(q), SIZE + 1, 4, 4))
        out[:, :SIZE] = np.eye(4) if displacement is None else se3.exp(displacement[:, :1])
        T = flange_transforms(q)
        out[:, SIZE] = T if displacement is None else out[:, 0] @ T @ se3.exp(displacement[:, SIZE])
        return out

    def joint_twists(self, frames: np.ndarray) -> np.ndarray:
        """(P, 6, 6): displacements along, then rotations about the axes of the base through the flange's origin."""
        out = np.zeros((len(frames), SIZE, 6))
        out[:, :3, :3] = np.eye(3)
        out[:, 3:] = rotation_twist(np.broadcast_to(np.eye(3), (len(frames), 3, 3)), frames[:, -1, None, :3, 3])
        return out

    def parameter_twists(self, frames: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(P, 6, 5, 6): the first of each five is that of the coordinate, the others move nothing."""
        out = np.zeros((len(frames), SIZE, 5, 6))
        out[:, :, 0] = self.joint_twists(frames)
        return out


def flange_transforms(q: np.ndarray) -> np.ndarray:
    """T_base_flange (P, 4, 4) of coordinates (P, 6) mm and rad."""
    return se3.transform(se3.rotation_exp(q[:, 3:]), q[:, :3])


def flange_coordinates(T: np.ndarray) -> np.ndarray:
    """The coordinates (P, 6) mm and rad of T_base_flange (P, 4, 4)."""
    return se3.coordinates(T)
