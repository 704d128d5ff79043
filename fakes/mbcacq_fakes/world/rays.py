"""The camera's rays and where they first meet spheres, rods and a plate.

Pixel (row i, column j) looks along x = u_j (a_x + b_x z), y = v_i (a_y + b_y z), with u, v in (-1, 1): straight lines that fill the
scanner's frustum exactly. The ray parameter is z itself; the scanner looks down, so the first hit is the one with the largest z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq_fakes.world.description import ScannerView


@dataclass(frozen=True)
class Grid:
    """Pixel grid over a view. slope, width: (2,) of the half width along x, y: half(z) = width + slope z."""

    view: ScannerView
    rows: int
    columns: int

    @classmethod
    def with_pitch(cls, view: ScannerView, pitch_mm: float) -> Grid:
        """About ``pitch_mm`` between neighbouring points in the middle of the measuring range."""
        middle = view.near_half + view.far_half
        columns, rows = np.maximum(np.rint(middle / pitch_mm), 8).astype(int)
        return cls(view, int(rows), int(columns))

    @classmethod
    def with_pixels(cls, view: ScannerView, pixels: float) -> Grid:
        middle = view.near_half + view.far_half
        return cls.with_pitch(view, float(np.sqrt(middle[0] * middle[1] / pixels)))

    @property
    def slope(self) -> np.ndarray:
        return (self.view.near_half - self.view.far_half) / (self.view.near_z - self.view.far_z)

    @property
    def width(self) -> np.ndarray:
        return self.view.near_half - self.slope * self.view.near_z

    def rays(self, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Foot (N, 3) at z = 0 and direction (N, 3) per unit of z of the rays of flat pixel indices (N,)."""
        i = pixel // self.columns
        u = (2 * (pixel - i * self.columns) + 1) / self.columns - 1
        v = (2 * i + 1) / self.rows - 1
        width, slope, zero = self.width, self.slope, np.zeros(len(pixel))
        return np.stack([u * width[0], v * width[1], zero], 1), np.stack([u * slope[0], v * slope[1], zero + 1], 1)

    def window(self, corners: np.ndarray) -> np.ndarray:
        """Flat indices of the pixels that can see into the box spanned by ``corners`` (2, 3) mm, low and high."""
        half = self.width + self.slope * np.clip(corners[:, 2:], self.view.far_z - 20, self.view.near_z + 20)
        ratio = corners[:, None, :2] / half[None]
        low, high = ratio.min(axis=(0, 1)), ratio.max(axis=(0, 1))
        size = np.array([self.columns, self.rows])
        first = np.clip(np.floor((low + 1) / 2 * size) - 1, 0, size).astype(int)
        last = np.clip(np.ceil((high + 1) / 2 * size) + 1, 0, size).astype(int)
        rows, columns = np.arange(first[1], last[1]), np.arange(first[0], last[0])
        return (rows[:, None] * self.columns + columns[None]).ravel()


def sphere(foot: np.ndarray, along: np.ndarray, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """z of the first hit (N,), nan where none, and distance (N,) mm of each ray from the centre."""
    a, b, c = _quadratic(foot - centre, along)
    inside = b * b - a * c + a * radius**2
    z = np.where(inside >= 0, (-b + np.sqrt(np.maximum(inside, 0))) / a, np.nan)
    return z, np.sqrt(np.maximum(c - b * b / a, 0))


def rod(foot: np.ndarray, along: np.ndarray, low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """z of the first hit (N,) of a round rod between two points (its mantle; ends open), nan where none."""
    length = np.linalg.norm(high - low)
    axis = (high - low) / length
    w = foot - low
    across_w, across_d = w - np.outer(w @ axis, axis), along - np.outer(along @ axis, axis)
    a, b, c = _quadratic(across_w, across_d)
    inside = b * b - a * (c - radius**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (-b + np.sqrt(np.maximum(inside, 0))) / a
    along_axis = (w + z[:, None] * along) @ axis
    return np.where((inside >= 0) & (a > 1e-12) & (along_axis >= 0) & (along_axis <= length), z, np.nan)


def rectangle(foot: np.ndarray, along: np.ndarray, T: np.ndarray, half: np.ndarray) -> np.ndarray:
    """z of the hit (N,) of a flat rectangle in the x, y plane of frame T (4, 4), half sizes (2,) mm; nan where none."""
    normal = T[:3, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (T[:3, 3] - foot) @ normal / (along @ normal)
        place = (foot + z[:, None] * along - T[:3, 3]) @ T[:3, :2]
    return np.where(np.all(np.abs(place) <= half, axis=1), z, np.nan)


def in_shadow(points: np.ndarray, lamp: np.ndarray, centres: np.ndarray, radii: np.ndarray, own: np.ndarray) -> np.ndarray:
    """(N,) bool: a sphere other than the point's ``own`` (N,) stands between the point and the lamp."""
    to_lamp = lamp - points
    distance = np.linalg.norm(to_lamp, axis=1)
    to_lamp /= distance[:, None]
    dark = np.zeros(len(points), dtype=bool)
    for k, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        w = centre - points
        ahead = np.einsum("nc,nc->n", w, to_lamp)
        miss2 = np.einsum("nc,nc->n", w, w) - ahead**2
        dark |= (own != k) & (ahead > 0) & (ahead < distance) & (miss2 < radius**2)
    return dark


def _quadratic(w: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.einsum("nc,nc->n", d, d), np.einsum("nc,nc->n", w, d), np.einsum("nc,nc->n", w, w)
