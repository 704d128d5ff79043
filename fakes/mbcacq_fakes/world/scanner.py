"""The fringe-projection scanner: what of a scene it measures, and how well."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq_fakes.world import rays
from mbcacq_fakes.world.artefact import Carrier
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_fakes.world.noise import ScannerNoise
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.rigid import carry

NO_BALL = -1


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


@dataclass(frozen=True)
class Scene:
    """What stands in front of the scanner, all in the scanner frame: ball centres (B, 3) mm, radii (B,), carrier moved by T (4, 4)."""

    centres: np.ndarray
    radii: np.ndarray
    carrier: Carrier | None = None
    T_scanner_artefact: np.ndarray | None = None


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

    def measure(self, scene: Scene, rng: np.random.Generator, exposure: float = 1.0) -> Points:
        """One exposure; ``exposure`` is relative to the right one (1.0): less light is noisier, too much saturates."""
        pixel, z, ball, rod = self._first_hits(scene, rng)
        foot, along = self.grid.rays(pixel)
        xyz = foot + z[:, None] * along
        normal = self._normals(scene, xyz, ball, rod)
        to_lamp = _unit(self.optics.lamp - xyz)
        facing = -np.einsum("nc,nc->n", normal, _unit(along) * -1)
        lit = np.einsum("nc,nc->n", normal, to_lamp)
        steepest = np.cos(np.radians(self.optics.grazing_deg))
        albedo = np.where(ball >= 0, self.optics.ball, np.where(rod, 0.3, self.optics.plate))
        signal = exposure * albedo * np.clip(lit, 0, None)
        # Fringe contrast fades towards grazing light; below a few grey levels the phase is lost.
        odds = np.clip((np.minimum(facing, lit) - steepest) / 0.12, 0, 1) * np.clip(signal / 0.04, 0, 1)
        keep = (rng.random(len(xyz)) < odds) & (signal < 1.3)
        keep &= ~rays.in_shadow(xyz, self.optics.lamp, scene.centres, scene.radii, ball)
        pixel, xyz, ball, along = pixel[keep], xyz[keep], ball[keep], along[keep]
        contrast = np.minimum(facing, lit)[keep] * np.clip(signal[keep] / (self.optics.ball * 0.5), 0.1, 1)
        grain = self.noise.speckle_mm * np.minimum(1 / np.maximum(contrast, 0.1), 6) ** 0.5 * rng.standard_normal(len(xyz))
        intensity = np.clip(255 * signal[keep] * (1 + 0.03 * rng.standard_normal(len(xyz))), 1, 255)
        xyz += grain[:, None] * along
        xyz, pixel, ball, intensity = self._with_rims(scene, xyz, pixel, ball, intensity, rng)
        xyz += self.noise.smooth(xyz[:, :2], rng)
        return Points(pixel, xyz, ball, intensity.astype(np.uint8))

    def frame(self, points: Points, time_s: float = 0.0) -> ScannerFrame:
        """Points outside the measuring range are lost; of two on one pixel the later wins."""
        view = self.grid.view
        inside = (points.xyz[:, 2] <= view.near_z) & (points.xyz[:, 2] >= view.far_z)
        xyz = np.full((self.grid.rows * self.grid.columns, 3), np.nan, dtype=np.float32)
        intensity = np.zeros(len(xyz), dtype=np.uint8)
        xyz[points.pixel[inside]] = points.xyz[inside]
        intensity[points.pixel[inside]] = points.intensity[inside]
        shape = (self.grid.rows, self.grid.columns)
        return ScannerFrame(xyz.reshape(*shape, 3), intensity.reshape(shape), time_s)

    def _first_hits(self, scene: Scene, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
        """pixel, z, ball index, is-rod of the first surface along each ray that meets one."""
        depth = np.full(self.grid.rows * self.grid.columns, -np.inf)
        label = np.full(len(depth), -3, dtype=np.int16)
        for k, (centre, radius) in enumerate(zip(scene.centres, scene.radii, strict=True)):
            pixel = self.grid.window(centre + np.array([[-radius] * 3, [radius] * 3]))
            _nearer(depth, label, pixel, rays.sphere(*self.grid.rays(pixel), centre, radius)[0], k)
        if scene.carrier is not None:
            carrier, T = scene.carrier, scene.T_scanner_artefact
            assert T is not None, "a carrier comes with its pose"
            for low, high in carry(T, carrier.rods):
                ends = np.stack([low, high])
                pixel = self.grid.window(np.stack([ends.min(axis=0), ends.max(axis=0)]) + carrier.rod_radius * np.array([[-1], [1]]))
                _nearer(depth, label, pixel, rays.rod(*self.grid.rays(pixel), low, high, carrier.rod_radius), -2)
            some = label != -3
            some[rng.integers(0, len(depth), int(self.optics.backdrop * len(depth)))] = True
            pixel = np.flatnonzero(some)
            _nearer(depth, label, pixel, rays.rectangle(*self.grid.rays(pixel), T @ carrier.plate, carrier.plate_half), NO_BALL)
        pixel = np.flatnonzero((label != -3) & (depth > self.grid.view.far_z - 5) & (depth < self.grid.view.near_z + 5))
        return pixel, depth[pixel], np.maximum(label[pixel], NO_BALL).astype(int), label[pixel] == -2

    def _normals(self, scene: Scene, xyz: np.ndarray, ball: np.ndarray, rod: np.ndarray) -> np.ndarray:
        """Outward unit normals (N, 3)."""
        normal = np.zeros_like(xyz)
        on = ball >= 0
        normal[on] = (xyz[on] - scene.centres[ball[on]]) / scene.radii[ball[on], None]
        if scene.carrier is not None:
            assert scene.T_scanner_artefact is not None, "a carrier comes with its pose"
            up = scene.T_scanner_artefact[:3, 2]
            normal[~on] = up if up[2] > 0 else -up
            normal[rod] = _unit(np.array([0, 0, 1.0]) - up[2] * up + 1e-9)
        return normal

    def _with_rims(self, scene, xyz, pixel, ball, intensity, rng):
        """Add mixed pixels: at a ball's silhouette some pixels report a depth between the ball and what lies behind."""
        width = float(np.mean((self.grid.view.near_half + self.grid.view.far_half) / [self.grid.columns, self.grid.rows]))
        more_pixel, more_xyz = [], []
        for centre, radius in zip(scene.centres, scene.radii, strict=True):
            near = self.grid.window(centre + (radius + width) * np.array([[-1.0] * 3, [1.0] * 3]))
            foot, along = self.grid.rays(near)
            miss = rays.sphere(foot, along, centre, radius)[1]
            rim = (miss > radius - 0.3 * width) & (miss < radius + 0.7 * width) & (rng.random(len(near)) < self.optics.edge)
            z = centre[2] - 8.0 * rng.random(rim.sum()) ** 2
            more_pixel.append(near[rim])
            more_xyz.append(foot[rim] + z[:, None] * along[rim])
        if not more_pixel:
            return xyz, pixel, ball, intensity
        more = np.concatenate(more_pixel)
        taken = np.zeros(self.grid.rows * self.grid.columns, dtype=bool)
        taken[pixel] = True
        fresh = ~taken[more]
        more, extra = more[fresh], np.concatenate(more_xyz)[fresh]
        return (
            np.concatenate([xyz, extra]),
            np.concatenate([pixel, more]),
            np.concatenate([ball, np.full(len(more), NO_BALL)]),
            np.concatenate([intensity, np.full(len(more), 20.0)]),
        )


def _nearer(depth: np.ndarray, label: np.ndarray, pixel: np.ndarray, z: np.ndarray, name: int) -> None:
    hit = z > depth[pixel]
    depth[pixel[hit]] = z[hit]
    label[pixel[hit]] = name


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
