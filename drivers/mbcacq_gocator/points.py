"""The surface of a classic Gocator as points in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.devices import ProtocolError
from mbcacq_gocator.conversion import picked, valid_points
from mbcacq_gocator.decode import ArrayMessage
from mbcacq_gocator.layouts import SURFACE_POINTS, UNIFORM_SURFACE


@dataclass(frozen=True)
class SurfaceMessage:
    """points: (N, 3) float32 mm. pixel: (N,) int32 = row * width + column of each. shape: (length, width) of the grid."""

    points: np.ndarray
    pixel: np.ndarray
    shape: tuple[int, int]


def surface_points(message: ArrayMessage) -> SurfaceMessage:
    """The valid points of a surface, copied. A pixel is valid if its z is. Raises ProtocolError."""
    if message.type not in (SURFACE_POINTS, UNIFORM_SURFACE):
        raise ProtocolError(f"a message of type {message.type} is no surface")
    length, width = message.array.shape[:2]
    return SurfaceMessage(*valid_points(message.array, *_scales(message)), (length, width))


def intensity_of(message: ArrayMessage, surface: SurfaceMessage) -> np.ndarray:
    """(N,) uint8 of every point, copied. The intensity image must have the surface's own shape, else ProtocolError."""
    if message.array.shape != surface.shape:
        raise ProtocolError(f"the intensity image is {message.array.shape} but the surface {surface.shape}")
    return picked(message.array, surface.pixel)


def _scales(message: ArrayMessage) -> tuple[np.ndarray, np.ndarray]:
    try:
        scale = np.array([message.attributes[f"{axis}_resolution"] for axis in "xyz"]) / 1e6
        offset = np.array([message.attributes[f"{axis}_offset"] for axis in "xyz"]) / 1e3
    except KeyError as missing:
        raise ProtocolError(f"a Gocator surface does not say its {missing}") from None
    return scale, offset
