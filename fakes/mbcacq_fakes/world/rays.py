"""The camera's rays and where they first meet spheres, rods and a plate.

Pixel (row i, column j) looks along x = u_j (a_x + b_x z), y = v_i (a_y + b_y z), with u, v in (-1, 1): straight lines that fill the
scanner's frustum exactly. The ray parameter is z itself; the scanner looks down, so the first hit is the one with the largest z.

x depends on the column alone and y on the row alone. Over a rectangle of pixels every quadratic form of the rays is therefore a sum of one
term for each column and one for each row.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq_fakes.world.description import ScannerView


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels of a grid, R rows by C columns, and its rays (x, y) = foot + z along.

    foot, along: per axis, x as (1, C) and y as (R, 1).
    """

    rows: slice
    columns: slice
    foot: tuple[np.ndarray, np.ndarray]
    along: tuple[np.ndarray, np.ndarray]


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
    def shape(self) -> tuple[int, int]:
        return self.rows, self.columns

    @property
    def slope(self) -> np.ndarray:
        return (self.view.near_half - self.view.far_half) / (self.view.near_z - self.view.far_z)

    @property
    def width(self) -> np.ndarray:
        return self.view.near_half - self.slope * self.view.near_z

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Foot and direction along x of each column, along y of each row."""
        u = (2 * np.arange(self.columns) + 1) / self.columns - 1
        v = (2 * np.arange(self.rows) + 1) / self.rows - 1
        return u * self.width[0], u * self.slope[0], v * self.width[1], v * self.slope[1]

    def rays(self, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Foot (3, N) at z = 0 and direction (3, N) per unit of z of the rays of flat pixel indices (N,)."""
        row = pixel // self.columns
        column = pixel - row * self.columns
        foot, along = np.zeros((3, len(pixel))), np.ones((3, len(pixel)))
        foot_x, along_x, foot_y, along_y = self._tables
        foot[0], foot[1] = foot_x[column], foot_y[row]
        along[0], along[1] = along_x[column], along_y[row]
        return foot, along

    def window(self, corners: np.ndarray) -> Window:
        """The pixels that can see into the box spanned by ``corners`` (2, 3) mm, low and high."""
        half = self.width + self.slope * np.clip(corners[:, 2:], self.view.far_z - 20, self.view.near_z + 20)
        ratio = corners[:, None, :2] / half[None]
        low, high = ratio.min(axis=(0, 1)), ratio.max(axis=(0, 1))
        size = np.array([self.columns, self.rows])
        first = np.clip(np.floor((low + 1) / 2 * size) - 1, 0, size).astype(int).tolist()
        last = np.clip(np.ceil((high + 1) / 2 * size) + 1, 0, size).astype(int).tolist()
        columns, rows = slice(first[0], last[0]), slice(first[1], last[1])
        foot_x, along_x, foot_y, along_y = self._tables
        return Window(rows, columns, (foot_x[None, columns], foot_y[rows, None]), (along_x[None, columns], along_y[rows, None]))

    def pixels(self, window: Window) -> np.ndarray:
        """Flat indices (R C,) of a window's pixels, row by row."""
        rows, columns = np.arange(self.rows)[window.rows], np.arange(self.columns)[window.columns]
        return (rows[:, None] * self.columns + columns).ravel()


def sphere(window: Window, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """z of the first hit (R, C), nan where none, and distance (R, C) mm of each ray from the centre."""
    wx, wy = window.foot[0] - centre[0], window.foot[1] - centre[1]
    dx, dy = window.along
    a = dx * dx + (dy * dy + 1.0)
    b = wx * dx + (wy * dy - centre[2])
    c = wx * wx + (wy * wy + centre[2] ** 2)
    miss2 = c - b * b / a
    inside = radius**2 - miss2
    z = np.where(inside >= 0, np.sqrt(np.maximum(inside, 0.0) / a) - b / a, np.nan)
    return z, np.sqrt(np.maximum(miss2, 0.0))


def rod(window: Window, low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """z of the first hit (R, C) of a round rod between two points (its mantle; ends open), nan where none."""
    length = np.linalg.norm(high - low)
    axis = (high - low) / length
    wx, wy = window.foot[0] - low[0], window.foot[1] - low[1]
    dx, dy = window.along
    along_w = wx * axis[0] + (wy * axis[1] - low[2] * axis[2])
    along_d = dx * axis[0] + (dy * axis[1] + axis[2])
    a = dx * dx + (dy * dy + 1.0) - along_d * along_d
    b = wx * dx + (wy * dy - low[2]) - along_w * along_d
    c = wx * wx + (wy * wy + low[2] ** 2) - along_w * along_w
    inside = b * b - a * (c - radius**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (np.sqrt(np.maximum(inside, 0.0)) - b) / a
        place = along_w + z * along_d
    return np.where((inside >= 0) & (a > 1e-12) & (place >= 0) & (place <= length), z, np.nan)


def rectangle(foot: np.ndarray, along: np.ndarray, T: np.ndarray, half: np.ndarray) -> np.ndarray:
    """z of the hit (N,) of rays (3, N) with a flat rectangle in the x, y plane of frame T (4, 4), half sizes (2,) mm; nan where none."""
    normal, origin = T[:3, 2], T[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (origin @ normal - normal @ foot) / (normal @ along)
        place = np.abs(T[:3, :2].T @ (foot + z * along - origin[:, None]))
    return np.where((place[0] <= half[0]) & (place[1] <= half[1]), z, np.nan)


def in_shadow(points: np.ndarray, lamp: np.ndarray, centres: np.ndarray, radii: np.ndarray, own: np.ndarray) -> np.ndarray:
    """(N,) bool: a sphere (B of them) other than the point's ``own`` (N,) stands between the point (3, N) and the lamp."""
    to_lamp = lamp[:, None] - points
    distance = np.sqrt(np.einsum("cn,cn->n", to_lamp, to_lamp))
    to_lamp /= distance
    dark = np.zeros(points.shape[1], dtype=bool)
    from_lamp = centres - lamp
    for k, (centre, radius) in enumerate(zip(from_lamp, radii, strict=True)):
        before = -(centre @ to_lamp)  # along the ray, from the lamp
        near = (centre @ centre - before * before < radius**2) & (before > 0) & (before < distance) & (own != k)
        dark |= near
    return dark
