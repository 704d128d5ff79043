"""What the fake scanner measures, with its own optics, rods, shadows and mixed points, must come out unbiased too."""

import clouds
import numpy as np
import pytest

from mbcacq.spheres.extract import find_spheres

world = pytest.importorskip("mbcacq_fakes.world.scanner")


def frames(rng, runs):
    from mbcacq_fakes.world.artefact import carrier
    from mbcacq_fakes.world.description import ArtefactFacts, ScannerView
    from mbcacq_fakes.world.noise import ScannerNoise
    from mbcacq_fakes.world.rays import Grid

    mbc = clouds.artefact()
    scanner = world.FringeScanner(Grid.with_pitch(ScannerView(), 0.25), ScannerNoise.for_centres(np.zeros(3)))
    facts = ArtefactFacts(mbc.id, mbc.ball_ids, mbc.centres, mbc.diameters, 0.0)
    for _ in range(runs):
        T = np.eye(4)
        T[:3, :3] = clouds.rotation(rng.normal(size=3) * [1, 1, 3], rng.uniform(0, 20))
        T[:3, 3] = rng.uniform(-4, 4, 3)
        centres = mbc.centres @ T[:3, :3].T + T[:3, 3]
        points = scanner.frame(scanner.measure(world.Scene(centres, mbc.diameters / 2, carrier(facts), T), rng)).xyz.reshape(-1, 3)
        yield mbc, centres, points[np.isfinite(points[:, 2])]


def test_centres_are_unbiased_and_their_covariance_holds():
    errors, scaled = [], []
    for mbc, centres, points in frames(np.random.default_rng(0), 25):
        found = find_spheres(points, mbc)
        assert len(found) >= 6
        error = found.xyz - centres[[mbc.ball_ids.index(b) for b in found.ball]]
        errors.append(error)
        scaled.append(error / np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2)))
    errors, scaled = np.concatenate(errors), np.concatenate(scaled)
    assert np.all(np.abs(errors.mean(axis=0)) < 4 * errors.std(axis=0) / np.sqrt(len(errors)))
    assert np.abs(errors).max() < 0.004
    assert np.all((scaled.std(axis=0) > 0.8) & (scaled.std(axis=0) < 1.25))
