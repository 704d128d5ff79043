"""What a scanner's rays meet of a scene, as far as no draw of noise decides it: the same for all exposures of one scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq_fakes.world import rays
from mbcacq_fakes.world.artefact import Carrier
from mbcacq_fakes.world.mesh import first_hits, shaded
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.rigid import carry

NO_BALL = -1
_ROD, _NOTHING = -2, -3
_RIM = 0.3, 0.7  # widths of a pixel inside and outside of a silhouette where a pixel mixes ball and background
_BEYOND_MM = 5.0  # outside the measuring range to which surfaces are met


@dataclass(frozen=True)
class Scene:
    """What stands in front of the scanner, all in the scanner frame: ball centres (B, 3) mm, radii (B,), carrier moved by T (4, 4)."""

    centres: np.ndarray
    radii: np.ndarray
    carrier: Carrier | None = None
    T_scanner_artefact: np.ndarray | None = None
    triangles: np.ndarray | None = None  # (T, 3, 3) mm in the artefact's frame: the surface of a part, which has neither balls nor carrier

    def equals(self, other: Scene) -> bool:
        """Nothing differs, to the last bit."""
        if self.carrier is not other.carrier or self.triangles is not other.triangles or len(self.centres) != len(other.centres):
            return False
        same = np.array_equal(self.centres, other.centres) and np.array_equal(self.radii, other.radii)
        if self.T_scanner_artefact is None or other.T_scanner_artefact is None:
            return same and self.T_scanner_artefact is other.T_scanner_artefact
        return same and np.array_equal(self.T_scanner_artefact, other.T_scanner_artefact)


@dataclass(frozen=True)
class Hits:
    """Where rays meet a surface. pixel (N,) flat index; xyz, along (3, N): place in mm and direction per unit of z; ball (N,) index or
    NO_BALL; rod, part (N,): on one. facing, lit (N,): cosines of the incidence seen from the camera and from the lamp; dark (N,): in
    shadow."""

    pixel: np.ndarray
    xyz: np.ndarray
    along: np.ndarray
    ball: np.ndarray
    rod: np.ndarray
    part: np.ndarray
    facing: np.ndarray
    lit: np.ndarray
    dark: np.ndarray

    def merged_with(self, other: Hits) -> Hits:
        """Both, in the order of their pixels."""
        if not len(other.pixel):
            return self
        order = np.argsort(np.concatenate([self.pixel, other.pixel]), kind="stable")
        return Hits(
            *(np.concatenate([a, b], axis=-1).take(order, axis=-1) for a, b in zip(vars(self).values(), vars(other).values(), strict=True))
        )


@dataclass(frozen=True)
class Rim:
    """Pixels at the silhouette of one ball: how many of the ``examined`` ones around it, which of these (n,), their flat indices, feet and
    directions (3, n), and z of the ball's centre."""

    examined: int
    chosen: np.ndarray
    pixel: np.ndarray
    foot: np.ndarray
    along: np.ndarray
    z: float


class Surfaces:
    """The surfaces of a scene that a grid's rays meet first. lamp: (3,) mm, place of the projector."""

    def __init__(self, grid: Grid, scene: Scene, lamp: np.ndarray) -> None:
        self.scene = scene
        self._grid, self._lamp = grid, lamp
        if scene.triangles is not None:
            self.solid, self.rims = self._of_part(scene.triangles), []
            return
        depth, label = self._nearest()
        self.free = label.ravel() == _NOTHING
        self.solid = self._hits(np.flatnonzero(~self.free), depth, label)
        self.rims = [self._rim(centre, radius) for centre, radius in zip(scene.centres, scene.radii, strict=True)]

    def backdrop(self, looks: np.ndarray) -> Hits:
        """Hits on the plate of the pixels ``looks`` (k,) that meet nothing else; any order, some perhaps twice."""
        some = np.zeros(len(self.free), dtype=bool)
        some[looks] = True
        some &= self.free
        pixel = np.flatnonzero(some)
        z = self._on_plate(pixel)
        met = np.isfinite(z)
        return self._described(pixel[met], z[met], np.full(int(met.sum()), NO_BALL))

    def _of_part(self, triangles: np.ndarray) -> Hits:
        """Hits on the surface of a part."""
        T, grid = self.scene.T_scanner_artefact, self._grid
        assert T is not None, "a part comes with its pose"
        pixel = np.arange(grid.rows * grid.columns)
        foot, along = grid.rays(pixel)
        z, normal, surface = first_hits(triangles, T, foot, along, grid.view.near_z + _BEYOND_MM)
        met = np.flatnonzero(z > grid.view.far_z - _BEYOND_MM)
        xyz, along, normal = foot[:, met] + z[met] * along[:, met], along[:, met], normal[:, met]
        to_lamp = self._lamp[:, None] - xyz
        return Hits(
            pixel=pixel[met],
            xyz=xyz,
            along=along,
            ball=np.full(len(met), NO_BALL),
            rod=np.zeros(len(met), bool),
            part=np.ones(len(met), bool),
            facing=np.einsum("cn,cn->n", normal, along) / np.linalg.norm(along, axis=0),
            lit=np.einsum("cn,cn->n", normal, to_lamp) / np.linalg.norm(to_lamp, axis=0),
            dark=shaded(surface, T, xyz, to_lamp),
        )

    def _nearest(self) -> tuple[np.ndarray, np.ndarray]:
        """z and label (rows, columns) of the first surface along each ray; the plate only where something else was met, too."""
        scene, grid = self.scene, self._grid
        depth, label = np.full(grid.shape, -np.inf), np.full(grid.shape, _NOTHING, dtype=np.int16)
        for k, (centre, radius) in enumerate(zip(scene.centres, scene.radii, strict=True)):
            window = grid.window(centre + np.array([[-radius] * 3, [radius] * 3]))
            _nearer(depth, label, window, rays.sphere(window, centre, radius)[0], k)
        if scene.carrier is not None:
            assert scene.T_scanner_artefact is not None, "a carrier comes with its pose"
            reach = scene.carrier.rod_radius * np.array([[-1], [1]])
            for low, high in carry(scene.T_scanner_artefact, scene.carrier.rods):
                ends = np.stack([low, high])
                window = grid.window(np.stack([ends.min(axis=0), ends.max(axis=0)]) + reach)
                _nearer(depth, label, window, rays.rod(window, low, high, scene.carrier.rod_radius), _ROD)
            pixel = np.flatnonzero(label.ravel() != _NOTHING)
            z = self._on_plate(pixel)
            before = pixel[z > depth.ravel()[pixel]]
            depth.ravel()[before], label.ravel()[before] = z[z > depth.ravel()[pixel]], NO_BALL
        return depth, label

    def _on_plate(self, pixel: np.ndarray) -> np.ndarray:
        carrier, T = self.scene.carrier, self.scene.T_scanner_artefact
        assert carrier is not None, "there is a plate where there is a carrier"
        assert T is not None, "a carrier comes with its pose"
        return rays.rectangle(*self._grid.rays(pixel), T @ carrier.plate, carrier.plate_half)

    def _hits(self, pixel: np.ndarray, depth: np.ndarray, label: np.ndarray) -> Hits:
        return self._described(pixel, depth.ravel()[pixel], label.ravel()[pixel].astype(int))

    def _described(self, pixel: np.ndarray, z: np.ndarray, label: np.ndarray) -> Hits:
        view = self._grid.view
        inside = (z > view.far_z - _BEYOND_MM) & (z < view.near_z + _BEYOND_MM)
        pixel, z, label = pixel[inside], z[inside], label[inside]
        foot, along = self._grid.rays(pixel)
        xyz = foot + z * along
        ball, rod = np.maximum(label, NO_BALL), label == _ROD
        normal = self._normals(xyz, ball, rod)
        to_lamp = self._lamp[:, None] - xyz
        lit = np.einsum("cn,cn->n", normal, to_lamp) / np.sqrt(np.einsum("cn,cn->n", to_lamp, to_lamp))
        facing = np.einsum("cn,cn->n", normal, along) / np.sqrt(np.einsum("cn,cn->n", along, along))
        dark = rays.in_shadow(xyz, self._lamp, self.scene.centres, self.scene.radii, ball)
        return Hits(
            pixel=pixel, xyz=xyz, along=along, ball=ball, rod=rod, part=np.zeros(len(ball), bool), facing=facing, lit=lit, dark=dark
        )

    def _normals(self, xyz: np.ndarray, ball: np.ndarray, rod: np.ndarray) -> np.ndarray:
        """Outward unit normals (3, N)."""
        scene, normal = self.scene, np.zeros_like(xyz)
        if len(scene.centres):
            normal = (xyz - scene.centres.T[:, ball]) / scene.radii[ball]
        if scene.T_scanner_artefact is not None:
            up = scene.T_scanner_artefact[:3, 2]
            normal[:, ball < 0] = (up if up[2] > 0 else -up)[:, None]
            side = np.array([0, 0, 1.0]) - up[2] * up + 1e-9
            normal[:, rod] = (side / np.linalg.norm(side))[:, None]
        return normal

    def _rim(self, centre: np.ndarray, radius: float) -> Rim:
        grid = self._grid
        width = float(np.mean((grid.view.near_half + grid.view.far_half) / [grid.columns, grid.rows]))
        window = grid.window(centre + (radius + width) * np.array([[-1.0] * 3, [1.0] * 3]))
        miss = rays.sphere(window, centre, radius)[1].ravel()
        chosen = np.flatnonzero((miss > radius - _RIM[0] * width) & (miss < radius + _RIM[1] * width))
        pixel = grid.pixels(window)[chosen]
        return Rim(len(miss), chosen, pixel, *grid.rays(pixel), float(centre[2]))


def _nearer(depth: np.ndarray, label: np.ndarray, window: rays.Window, z: np.ndarray, name: int) -> None:
    """Note under ``name`` the rays of a window whose hit z (R, C) comes before what they met so far."""
    known = depth[window.rows, window.columns]
    hit = z > known
    known[hit] = z[hit]
    label[window.rows, window.columns][hit] = name
