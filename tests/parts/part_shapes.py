"""Surfaces of known shape, seen by the fake scanner from known places."""

from __future__ import annotations

import numpy as np
from mbcacq_fakes.world.description import ScannerView
from mbcacq_fakes.world.noise import ScannerNoise
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.scanner import FringeScanner
from mbcacq_fakes.world.surfaces import Scene

from mbcacq.geometry import se3


def height_field(z, half=(60.0, 45.0), cells=(48, 36)):
    """Triangles (T, 3, 3) mm of z(x, y), anticlockwise from above."""
    x, y = np.meshgrid(*(np.linspace(-h, h, n + 1) for h, n in zip(half, cells, strict=True)), indexing="ij")
    p = np.stack([x, y, z(x, y)], axis=-1)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)


def casting(x, y):
    return 6 * np.sin(x / 17) * np.cos(y / 14) + 9 * np.exp(-(((x - 15) / 14) ** 2 + ((y + 8) / 12) ** 2))


def blocks(x, y):
    """Two ramps and a step between them, as of milled blocks."""
    return np.where(x > 10, 10 + 0.35 * (x - 10), 0.3 * y) + np.clip(2.5 * (x - 4), 0, 15) * (x <= 10)


def turned(x, y):
    """A surface of revolution about z."""
    r = np.hypot(x, y)
    return 10 * np.cos(r / 14)


SHAPES = {"casting": casting, "blocks": blocks, "turned": turned}
SCANNER = FringeScanner(Grid.with_pitch(ScannerView(), 0.8), ScannerNoise.for_centres(np.array([0.005, 0.005, 0.009]), 0.012, 12.0))


def look(tilt_deg, azimuth_deg, roll_deg=0.0, shift_mm=(0.0, 0.0)):
    """T_part_scanner (4, 4) of a view at the middle of the part."""
    tilt, azimuth, roll = np.radians([tilt_deg, azimuth_deg, roll_deg])
    R = (
        se3.rotation_exp(np.array([0, 0, azimuth]))
        @ se3.rotation_exp(np.array([0, tilt, 0]))
        @ se3.rotation_exp(np.array([0, 0, roll - azimuth]))
    )
    return se3.transform(R, np.array([*shift_mm, 0.0]))


def scan(rng, triangles, T_part_scanner):
    """Points (N, 3) mm in the scanner frame."""
    scene = Scene(np.zeros((0, 3)), np.zeros(0), T_scanner_artefact=np.linalg.inv(T_part_scanner), triangles=triangles)
    return SCANNER.measure(scene, rng).xyz
