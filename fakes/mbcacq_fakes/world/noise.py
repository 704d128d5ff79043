"""Measurement noise of a fringe-projection scanner: a smooth error of the phase over the field, and speckle of each point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq_fakes.world.description import ScannerView


@dataclass(frozen=True)
class NoiseGrowth:
    """How the noise grows over the field of view. It grows by ``ratio`` (3,) along x, y, z for each ``span_mm`` away from ``middle_z``,
    away from the scanner, and with the incidence by its cosine to the power of -``slant``."""

    ratio: np.ndarray
    middle_z: float
    span_mm: float
    slant: float

    @classmethod
    def stated(cls, view: ScannerView, noise_mm: Sequence[float], far_mm: Sequence[float] | None, factor_at_60_deg: float) -> NoiseGrowth:
        """Noise of a scanner whose centres scatter by noise_mm (3,) in the middle of its view and by far_mm (3,) at the far end."""
        middle = np.asarray(noise_mm, dtype=float)
        far = middle if far_mm is None else np.asarray(far_mm, dtype=float)
        ratio = np.divide(far, middle, out=np.ones(3), where=(middle > 0) & (far > 0))
        z = (view.near_z + view.far_z) / 2
        return cls(ratio, z, z - view.far_z, float(np.log2(factor_at_60_deg)))

    def factors(self, z: np.ndarray, facing: np.ndarray) -> np.ndarray:
        """(3, N) at places z (N,) mm seen at the cosine of incidence ``facing`` (N,)."""
        out = np.ones((3, len(z)))
        if np.any(self.ratio != 1):
            out *= self.ratio[:, None] ** ((self.middle_z - z) / self.span_mm)
        if self.slant:
            out *= np.clip(facing, 0.1, 1.0) ** -self.slant
        return out


@dataclass(frozen=True)
class ScannerNoise:
    """field_mm: (3,) sigma of the smooth error along x, y, z; it varies over about ``pitch_mm``. speckle_mm: of one point along z
    at normal incidence. centre_mm: (3,) sigma of a fitted centre of a ball that results from both. growth: over the field of view.
    """

    field_mm: np.ndarray
    pitch_mm: float
    speckle_mm: float
    centre_mm: np.ndarray
    growth: NoiseGrowth | None = None

    @classmethod
    def for_centres(
        cls, centre_mm: np.ndarray, speckle_mm: float = 0.012, pitch_mm: float = 12.0, growth: NoiseGrowth | None = None
    ) -> ScannerNoise:
        """The noise whose fitted balls (known radius), as wide as ``pitch_mm``, scatter by ``centre_mm`` (3,), e.g. 0.005, 0.005, 0.009.

        A depth error that rises across a ball looks like a sideways shift of it, so the sideways field is smaller than the
        scatter asked for. The factors were found by Monte Carlo.
        """
        x, y, z = np.asarray(centre_mm, dtype=float)
        depth = z / SMOOTHED
        leak = LEAK * depth
        side = np.sqrt(np.maximum(np.array([x, y]) ** 2 - leak**2, 0.0)) / SMOOTHED
        return cls(np.append(side, depth), pitch_mm, speckle_mm, np.array([x, y, z]), growth)

    def smooth(self, xy: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Smooth error (3, N) mm at places xy (2, N) mm: cubic B-splines over independent knots, unit variance everywhere."""
        if not np.any(self.field_mm):
            return np.zeros((3, xy.shape[1]))
        place = xy / self.pitch_mm + rng.random(2)[:, None]
        cell = np.floor(place).astype(int)
        low = cell.min(axis=1, initial=0) - 1
        size = cell.max(axis=1, initial=0) - low + 3
        knots = rng.standard_normal((*size, 3))
        along_x, along_y = (_cubic(place[k] - cell[k]) for k in (0, 1))
        corner = (cell[0] - low[0] - 1) * size[1] + cell[1] - low[1] - 1
        channels = np.ascontiguousarray(knots.reshape(-1, 3).T)  # by axis: gathering rows of three costs most of an exposure
        out = np.zeros((3, xy.shape[1]))
        for i, j in np.ndindex(4, 4):
            share, at = along_x[i] * along_y[j], corner + (i * size[1] + j)
            for axis, knot in enumerate(channels):
                out[axis] += share * knot.take(at)
        out /= np.sqrt(np.einsum("kn,kn->n", along_x, along_x) * np.einsum("kn,kn->n", along_y, along_y))
        return out * self.field_mm[:, None]


SMOOTHED, LEAK = 0.935, 0.36  # share of the field left after averaging over a ball; sideways shift from the tilt of the depth field


def _cubic(t: np.ndarray) -> np.ndarray:
    """The four cubic B-spline weights (4, N) at offset t (N,) in [0, 1) between the second and third knot."""
    s = 1 - t
    t2, out = t * t, np.empty((4, len(t)))
    out[0], out[3] = s * s * s, t2 * t
    out[1] = 3 * out[3] - 6 * t2 + 4
    out[2] = 3 * (t + t2 - out[3]) + 1
    out /= 6
    return out
