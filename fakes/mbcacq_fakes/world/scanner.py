"""The fringe-projection scanner: what of a scene it measures, and how well."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq_fakes.world.description import ScannerView
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_fakes.world.noise import ScannerNoise
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.surfaces import NO_BALL, Scene, Surfaces


@dataclass(frozen=True)
class Optics:
    """lamp: (3,) mm, place of the projector in the scanner frame, aside of the camera. grazing_deg: nothing is measured at steeper
    incidence. ball, plate: reflectance. edge: share of the pixels at a ball's rim that mix ball and background. backdrop: share
    of the pixels that look at the dark plate at all (carbon fibre returns little light).
    """

    lamp: np.ndarray = field(default_factory=lambda: np.array([0.0, 90.0, 270.0]))
    grazing_deg: float = 72.0
    ball: float = 0.75
    plate: float = 0.10
    edge: float = 0.2
    backdrop: float = 0.03

    @classmethod
    def above(cls, view: ScannerView) -> Optics:
        """With the projector where the view's edges meet, a third of the way to it aside."""
        slope = (view.near_half - view.far_half) / (view.near_z - view.far_z)
        apex = np.divide(view.near_half, -slope, out=np.full(2, np.inf), where=slope < 0)  # mm above the near end
        height = float(np.clip(apex.mean(), view.near_z - view.far_z, 20 * (view.near_z - view.far_z)))
        return cls(lamp=np.array([0.0, height / 3, view.near_z + height]))


@dataclass(frozen=True)
class Points:
    """Measured points: pixel (N,) flat index, xyz (N, 3) mm, ball (N,) index or NO_BALL, intensity (N,) 0..255."""

    pixel: np.ndarray
    xyz: np.ndarray
    ball: np.ndarray
    intensity: np.ndarray


@dataclass(frozen=True)
class FringeScanner:
    grid: Grid
    noise: ScannerNoise
    optics: Optics = field(default_factory=Optics)

    def surfaces(self, scene: Scene) -> Surfaces:
        """What the rays meet, which all exposures of one scene share."""
        return Surfaces(self.grid, scene, self.optics.lamp)

    def measure(self, scene: Scene, rng: np.random.Generator, exposure: float = 1.0) -> Points:
        """One exposure of a scene, see ``expose``."""
        return self.expose(self.surfaces(scene), rng, exposure)

    def expose(self, surfaces: Surfaces, rng: np.random.Generator, exposure: float = 1.0) -> Points:
        """One exposure; ``exposure`` is relative to the right one (1.0): less light is noisier, too much saturates."""
        optics, hits = self.optics, surfaces.solid
        if surfaces.scene.carrier is not None:
            size = self.grid.rows * self.grid.columns
            hits = hits.merged_with(surfaces.backdrop(rng.integers(0, size, int(optics.backdrop * size))))
        steepest = np.cos(np.radians(optics.grazing_deg))
        albedo = np.where((hits.ball >= 0) | hits.part, optics.ball, np.where(hits.rod, 0.3, optics.plate))
        signal = exposure * albedo * np.clip(hits.lit, 0, None)
        slant = np.minimum(hits.facing, hits.lit)
        # Fringe contrast fades towards grazing light; below a few grey levels the phase is lost.
        odds = np.clip((slant - steepest) / 0.12, 0, 1) * np.clip(signal / 0.04, 0, 1)
        keep = np.flatnonzero((rng.random(len(odds)) < odds) & (signal < 1.3) & ~hits.dark)
        signal = signal[keep]
        contrast = slant[keep] * np.clip(signal / (optics.ball * 0.5), 0.1, 1)
        grain = self.noise.speckle_mm * np.sqrt(np.minimum(1 / np.maximum(contrast, 0.1), 6)) * rng.standard_normal(len(keep))
        growth = self._growth(hits.xyz[2, keep], hits.facing[keep])
        grain *= growth[2]
        intensity = np.clip(255 * signal * (1 + 0.03 * rng.standard_normal(len(keep))), 1, 255)
        xyz = hits.xyz[:, keep] + grain * hits.along[:, keep]
        pixel, ball = hits.pixel[keep], hits.ball[keep]
        rim, place = self._mixed_at_rims(surfaces, pixel, rng)
        xyz = np.concatenate([xyz, place], axis=1)
        field = self.noise.smooth(xyz[:2], rng)
        field[:, : len(pixel)] *= growth
        xyz += field
        return Points(
            np.concatenate([pixel, rim]),
            np.ascontiguousarray(xyz.T),
            np.concatenate([ball, np.full(len(rim), NO_BALL)]),
            np.concatenate([intensity, np.full(len(rim), 20.0)]).astype(np.uint8),
        )

    def frame(self, points: Points, time_s: float = 0.0) -> ScannerFrame:
        """Points outside the measuring range are lost; the later of two on one pixel wins."""
        view = self.grid.view
        inside = (points.xyz[:, 2] <= view.near_z) & (points.xyz[:, 2] >= view.far_z)
        xyz = np.full((self.grid.rows * self.grid.columns, 3), np.nan, dtype=np.float32)
        intensity = np.zeros(len(xyz), dtype=np.uint8)
        xyz[points.pixel[inside]] = points.xyz[inside]
        intensity[points.pixel[inside]] = points.intensity[inside]
        shape = (self.grid.rows, self.grid.columns)
        return ScannerFrame(xyz.reshape(*shape, 3), intensity.reshape(shape), time_s)

    def _growth(self, z: np.ndarray, facing: np.ndarray) -> np.ndarray:
        """(3, N) how much larger the noise is here than in the middle of the field of view, along x, y, z."""
        return np.ones((3, len(z))) if self.noise.growth is None else self.noise.growth.factors(z, facing)

    def _mixed_at_rims(self, surfaces: Surfaces, taken: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Mixed pixels: at a ball's silhouette some that were not ``taken`` report a depth between the ball and what lies behind.

        Returns flat indices (n,) and places (3, n) mm.
        """
        pixels, places = [np.zeros(0, dtype=int)], [np.zeros((3, 0))]
        for rim in surfaces.rims:
            mixed = rng.random(rim.examined)[rim.chosen] < self.optics.edge
            z = rim.z - 8.0 * rng.random(int(mixed.sum())) ** 2
            pixels.append(rim.pixel[mixed])
            places.append(rim.foot[:, mixed] + z * rim.along[:, mixed])
        used = np.zeros(self.grid.rows * self.grid.columns, dtype=bool)
        used[taken] = True
        pixel, place = np.concatenate(pixels), np.concatenate(places, axis=1)
        fresh = ~used[pixel]
        return pixel[fresh], place[:, fresh]
