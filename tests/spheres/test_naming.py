"""Identification of balls from their centres alone: right, or refused, over many random cells; never wrong."""

import clouds
import numpy as np
import pytest

from mbcacq.errors import DeviceFault
from mbcacq.spheres.fit import SphereFit
from mbcacq.spheres.found import SphereOptions
from mbcacq.spheres.naming import identify_spheres
from mbcacq.spheres.recognise import similarity_rms


def fitted(rng, artefact, balls, shift=0.0, stray=0):
    """Fits of some balls of an artefact anywhere, in any order, one of them displaced, the scale off by 500 ppm; and the true ids."""
    R = clouds.rotation(rng.normal(size=3), rng.uniform(0, 180))
    centres = artefact.centres @ R.T * (1 + rng.normal(0, 5e-4)) + rng.uniform(-20, 20, 3)
    centres += rng.normal(0, 0.01, centres.shape)
    centres[rng.integers(len(centres))] += rng.normal(0, shift, 3)
    chosen = rng.permutation(len(centres))[:balls]
    centres_found = [*centres[chosen], *rng.uniform(60, 80, (stray, 3))]
    ids = [*(artefact.ball_ids[i] for i in chosen), *[None] * stray]
    fits = [
        (
            6.0,
            SphereFit(
                centre=p,
                covariance=np.eye(3) * 4e-8,
                noise_mm=0.01,
                rms_mm=0.01,
                n_points=1500,
                coverage=0.9,
                radius_error=0.0,
                radius_sigma=0.001,
            ),
        )
        for p in centres_found
    ]
    return fits, ids


def named(fits, artefact, **more):
    found = identify_spheres(fits, [], artefact, None, None, SphereOptions(), **more)
    return {tuple(x): b for x, b in zip(found.xyz, found.ball, strict=True)}


@pytest.mark.parametrize(("balls", "stray"), [(8, 0), (8, 2), (6, 1), (4, 0), (4, 1)])
def test_every_name_is_right(balls, stray):
    rng = np.random.default_rng(balls + 10 * stray)
    missed = 0
    for _ in range(60):
        artefact = clouds.artefact(seed=int(rng.integers(1 << 30)))
        fits, ids = fitted(rng, artefact, balls, shift=0.06, stray=stray)
        got = named(fits, artefact)
        for (_, fit), true in zip(fits, ids, strict=True):
            ball = got.get(tuple(fit.centre))
            assert ball is None or ball == true
            missed += ball is None and true is not None
    assert missed <= 2


@pytest.mark.parametrize("balls", [4, 6, 8])
def test_another_artefact_is_always_refused(balls):
    rng = np.random.default_rng(balls)
    for _ in range(60):
        mine, other = (clouds.artefact(seed=int(rng.integers(1 << 30))) for _ in range(2))
        with pytest.raises(DeviceFault, match="wrong artefact in view"):
            named(fitted(rng, other, balls)[0], mine)


def test_the_mirror_image_of_any_artefact_is_refused():
    rng = np.random.default_rng(3)
    for _ in range(40):
        artefact = clouds.artefact(seed=int(rng.integers(1 << 30)))
        mirrored = clouds.make(artefact.centres * [1, 1, -1])
        with pytest.raises(DeviceFault, match="mirror image|wrong artefact"):
            named(fitted(rng, mirrored, 8)[0], artefact)


def test_the_similarity_fit_ignores_rotation_shift_and_scale_only():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(6, 3))
    R = clouds.rotation([1, 2, 3], 77)
    assert similarity_rms(a, 1.3 * a @ R.T + [5, 6, 7]) == pytest.approx(0, abs=1e-7)
    assert similarity_rms(a, a * [1, 1, -1]) > 0.1
    assert similarity_rms(a, a * [1, 1, -1], mirror=True) == pytest.approx(0, abs=1e-7)
