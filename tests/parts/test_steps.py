"""Steps between scans of shapes and of places that are known."""

import numpy as np
import part_shapes
import pytest

from mbcacq.geometry import se3
from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import surface_cells
from mbcacq.parts.scans import PartScan, surface_of
from mbcacq.parts.step import rigid_step, smooth_noise

OPTIONS = PartOptions()
EDGE_MM = 5.2


def pairs(shape, count, seed):
    """Overlaps of two views each, and the motion (6,) about the origin by which the first scan is off."""
    rng = np.random.default_rng(seed)
    triangles = part_shapes.height_field(part_shapes.SHAPES[shape])
    for _ in range(count):
        views = [part_shapes.look(*rng.uniform([5, 0, -60], [28, 360, 60]), shift_mm=rng.uniform(-12, 12, 2)) for _ in range(2)]
        scans = [surface_of(PartScan(k, np.zeros(6), part_shapes.scan(rng, triangles, T))) for k, T in enumerate(views)]
        placed = [(se3.apply(T, scan.points), scan.normals @ T[:3, :3].T) for T, scan in zip(views, scans, strict=True)]
        error = np.concatenate([rng.normal(0, 0.02, 3), rng.normal(0, 1e-4, 3)])
        E = se3.exp(error)
        moved = se3.apply(E, placed[0][0]), placed[0][1] @ E[:3, :3].T
        yield surface_cells([moved, placed[1]], EDGE_MM, OPTIONS).pair(0, 1), error


@pytest.fixture(scope="module")
def made():
    """Fourteen pairs of views of each shape."""
    return {shape: list(pairs(shape, 14, 3)) for shape in ("casting", "turned")}


@pytest.mark.parametrize("shape", ["casting", "turned"])
def test_steps_scatter_as_their_covariance_says(shape, made):
    made = made[shape]
    noise = smooth_noise([cells for cells, _ in made], OPTIONS)
    normalised, directions = 0.0, 0
    for cells, error in made:
        step = rigid_step(cells, noise, OPTIONS)
        true = np.concatenate([error[:3] + np.cross(error[3:], step.centre), error[3:]])
        G = step.determined.T * step.scaled
        off = G @ (step.twist - true)
        normalised += off @ np.linalg.solve(G @ step.covariance @ G.T, off)
        directions += len(G)
        if shape == "casting":
            assert not step.undetermined
        else:  # a body of revolution is the same turned about its axis, here z
            assert len(step.undetermined) == 1
            assert "about (0.0" in step.undetermined[0].replace("-", "")
            assert "1.00) through" in step.undetermined[0]
    assert 0.6 < normalised / directions < 1.5  # 84 and 70 values of mean 1: four of its sigmas


def test_the_smooth_noise_of_the_scanner_is_found(made):
    """Made with a depth error of 0.0096 mm (0.009 of a fitted centre) over knots of 12 mm; the distance of two scans has it twice."""
    noise = smooth_noise([cells for cells, _ in made["casting"]], OPTIONS)
    assert 0.75 < noise.sigma_mm / (np.sqrt(2) * 0.0096) < 1.25
    assert 7 < noise.length_mm < 15


def test_a_plane_shows_three_motions_of_six():
    rng = np.random.default_rng(1)
    plane = part_shapes.height_field(lambda x, y: 0 * x)
    placed = []
    for T in (part_shapes.look(10, 0), part_shapes.look(15, 120)):
        scan = surface_of(PartScan(0, np.zeros(6), part_shapes.scan(rng, plane, T)))
        placed.append((se3.apply(T, scan.points), scan.normals @ T[:3, :3].T))
    cells = surface_cells(placed, EDGE_MM, OPTIONS).pair(0, 1)
    step = rigid_step(cells, smooth_noise([cells], OPTIONS), OPTIONS)
    assert step.determined.shape == (6, 3)
    assert [text.split()[0] for text in step.undetermined] == ["about", "along", "along"]
    assert step.shown(np.array([1.0, 1, 0, 0, 0, 0.1])) == pytest.approx(np.zeros(6), abs=0.01)
