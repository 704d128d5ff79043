"""What the ray-cast scanner delivers: spheres that a plain fit finds where they are, with the stated scatter and the usual flaws."""

import numpy as np
import pytest
from mbcacq_fakes.world import artefact, rays
from mbcacq_fakes.world.description import ArtefactFacts, ScannerView
from mbcacq_fakes.world.noise import ScannerNoise
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.rigid import carry, displacement
from mbcacq_fakes.world.scanner import FringeScanner, Scene
from small_cell import BALLS, fit_sphere

NOISE_MM = np.array([0.005, 0.005, 0.009])
MBC = artefact.make(ArtefactFacts("mbc", tuple(range(1, 9)), BALLS, np.full(8, 12.0), 0.0), np.random.default_rng(0))


def scene(tilt_deg=15.0):
    T = displacement(np.zeros(3), np.radians([tilt_deg, 0, 0.0]))
    return Scene(carry(T, MBC.centres), MBC.radii, MBC.carrier, T)


@pytest.fixture(scope="module")
def scanner():
    return FringeScanner(Grid.with_pitch(ScannerView(), 0.25), ScannerNoise.for_centres(NOISE_MM))


@pytest.fixture(scope="module")
def errors(scanner):
    """(60, 8, 3) mm: fitted minus true centres over exposures of one scene, from frames and nothing but frames."""
    view, rng, out = scene(), np.random.default_rng(1), []
    for _ in range(60):
        xyz = scanner.frame(scanner.measure(view, rng)).xyz.reshape(-1, 3)
        xyz = xyz[np.isfinite(xyz[:, 2])].astype(float)
        out.append([fit_sphere(xyz[np.linalg.norm(xyz - c, axis=1) < 6.3], 6.0)[0] - c for c in view.centres])
    return np.array(out)


def test_centres_are_recovered_without_bias(errors):
    """60 exposures of 8 balls: the mean error of each ball stays within 4 standard errors of the stated noise."""
    assert np.all(np.abs(errors.mean(axis=0)) < 4 * NOISE_MM / np.sqrt(60))


def test_scatter_over_exposures_is_as_stated_and_worst_in_depth(errors):
    spread = errors.std(axis=0, ddof=1)
    rms = np.sqrt((spread**2).mean(axis=0))
    np.testing.assert_allclose(rms, NOISE_MM, rtol=0.12)  # 480 draws, partly shared: 3 sigma
    assert np.all(spread[:, 2] > spread[:, :2].max(axis=1))


def test_balls_scatter_nearly_independently(errors):
    correlation = np.corrcoef(errors[:, :, 2].T)[np.triu_indices(8, 1)]
    assert np.abs(correlation.mean()) < 0.1


def test_a_12_mm_ball_has_about_1500_points_and_fades_at_grazing_incidence(scanner):
    view = scene(0.0)
    points = scanner.measure(view, np.random.default_rng(2))
    for k, centre in enumerate(view.centres):
        on = points.xyz[points.ball == k]
        assert 1000 < len(on) < 2000
        height = (on[:, 2] - centre[2]) / 6.0  # cosine of the incidence for a viewer far above
        assert height.max() > 0.99
        assert height.min() > np.cos(np.radians(80))
    window = scanner.grid.window(view.centres[0] + np.array([[-6.0] * 3, [6.0] * 3]))
    met = np.isfinite(rays.sphere(window, view.centres[0], 6.0)[0]).sum()
    assert (points.ball == 0).sum() < 0.9 * met  # rays that meet the ball, but at too steep an incidence


def test_noise_grows_with_incidence(scanner):
    view = scene(0.0)
    rng, steep, flat = np.random.default_rng(3), [], []
    quiet = FringeScanner(scanner.grid, ScannerNoise(np.zeros(3), 16.0, 0.012, np.zeros(3)))
    for _ in range(10):
        points = quiet.measure(view, rng)
        for k, centre in enumerate(view.centres):
            away = points.xyz[points.ball == k] - centre
            error, height = np.linalg.norm(away, axis=1) - 6.0, away[:, 2] / 6.0
            depth = error / np.maximum(height, 0.2)  # back to the viewing direction
            steep.append(depth[(height < 0.5)])
            flat.append(depth[height > 0.95])
    assert np.concatenate(flat).std() == pytest.approx(0.012, rel=0.1)
    assert np.concatenate(steep).std() > 1.3 * np.concatenate(flat).std()


def test_edges_mix_ball_and_background(scanner):
    points = scanner.measure(scene(0.0), np.random.default_rng(4))
    centre = scene(0.0).centres[0]
    stray = points.xyz[points.ball < 0]
    across = np.linalg.norm((stray - centre)[:, :2], axis=1)
    rim = stray[(np.abs(across - 6.0) < 0.6) & (stray[:, 2] < centre[2]) & (stray[:, 2] > centre[2] - 8.5)]
    assert len(rim) > 10
    assert np.any(np.abs(np.linalg.norm(rim - centre, axis=1) - 6.0) > 0.5)


def test_a_ball_behind_another_is_not_measured(scanner):
    view = Scene(np.array([[0.0, 0, 20], [0.0, 0, -20], [25.0, 0, -20]]), np.array([9.0, 6.0, 6.0]))
    points = scanner.measure(view, np.random.default_rng(5))
    assert (points.ball == 1).sum() == 0
    assert (points.ball == 2).sum() > 900


def test_the_projectors_shadow_falls_on_a_neighbour(scanner):
    """A ball between projector (at +y, above) and another one takes its light, though the camera sees both."""
    lamp = scanner.optics.lamp
    low = np.array([0.0, 0.0, -30.0])
    between = low + 22.0 * (lamp - low) / np.linalg.norm(lamp - low)
    alone = scanner.measure(Scene(low[None], np.array([6.0])), np.random.default_rng(6))
    shaded = scanner.measure(Scene(np.stack([low, between]), np.array([6.0, 6.0])), np.random.default_rng(6))
    assert (shaded.ball == 0).sum() < 0.5 * (alone.ball == 0).sum()


def test_field_of_view_is_the_frustum(scanner):
    """Near 71 x 98 mm, far 100 x 154 mm, range 110 mm; nothing is reported outside."""
    grid = scanner.grid
    corner = np.array([grid.rows * grid.columns - 1])
    foot, along = grid.rays(corner)
    pixel = 1 / np.array([grid.columns, grid.rows])
    np.testing.assert_allclose((foot + 55 * along)[:2, 0], np.array([35.5, 49]) * (1 - pixel), rtol=1e-9)
    np.testing.assert_allclose((foot - 55 * along)[:2, 0], np.array([50, 77]) * (1 - pixel), rtol=1e-9)
    high = Scene(np.array([[0.0, 0, 52]]), np.array([6.0]))
    z = scanner.frame(scanner.measure(high, np.random.default_rng(7))).xyz[..., 2]
    assert np.nanmax(z) <= 55.0


def test_darkness_and_glare_lose_points(scanner):
    view, rng = scene(), np.random.default_rng(8)
    counts = [len(scanner.measure(view, rng, exposure).xyz) for exposure in (0.02, 1.0, 4.0)]
    assert counts[1] > 9000
    assert counts[0] < 0.3 * counts[1]
    assert counts[2] < 0.8 * counts[1]


def test_two_megapixels_are_possible():
    grid = Grid.with_pixels(ScannerView(), 2e6)
    assert grid.rows * grid.columns == pytest.approx(2e6, rel=0.01)
    points = FringeScanner(grid, ScannerNoise.for_centres(NOISE_MM)).measure(scene(), np.random.default_rng(9))
    assert min((points.ball == k).sum() for k in range(8)) > 10000
