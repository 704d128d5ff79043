"""Clouds of whole scenes in, named centres out."""

import clouds
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from mbcacq.errors import ConfigError, DeviceFault
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import SphereOptions

MBC = clouds.artefact()
TURN = clouds.rotation([1, 2, 0.5], 18)
CENTRES = MBC.centres @ TURN.T + [3, -4, 5]


@pytest.fixture(scope="module")
def cloud():
    return clouds.scan(np.random.default_rng(0), CENTRES, MBC.diameters, spacing=0.3)


@pytest.fixture(scope="module")
def centres_found(cloud):
    return find_spheres(cloud, MBC).xyz


def check(found, centres, artefact=MBC, ids=None):
    assert tuple(found.ball) == (artefact.ball_ids if ids is None else ids)
    error = found.xyz - centres[[artefact.ball_ids.index(b) for b in found.ball]]
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert np.all(np.abs(error) < 4.5 * sigma)
    assert np.all(np.abs(error) < 0.003)


def test_every_ball_over_a_plate_is_found_and_named(cloud):
    found = find_spheres(cloud, MBC)
    check(found, CENTRES)
    assert found.refused == []
    assert np.all(found.n_points > 800)
    assert np.all((found.rms_mm > 0.005) & (found.rms_mm < 0.012))
    assert found.xyz.dtype == np.float64


def test_each_ball_has_its_own_certified_diameter():
    """12 mm balls as a measuring machine finds them, 20 um apart: sought as one size, each fitted with its own."""
    own = clouds.make(MBC.centres, 12 + np.array([8, -3, 0, 5, -9, 1, 11, -2]) * 1e-3)
    points = clouds.scan(np.random.default_rng(0), CENTRES, own.diameters, spacing=0.3, noise=0.002)
    found = find_spheres(points, own)
    check(found, CENTRES, own)
    assert np.abs(found.radius_error_mm).max() < 0.002


@pytest.mark.parametrize(("plate", "tilt"), [(None, 0), (-14, 8), (0, 0), (3, 0)])
def test_a_plate_may_be_absent_tilted_or_cut_the_balls(plate, tilt):
    flat = clouds.make(np.array([[-30, -20, 0], [25, -25, 1], [30, 22, 0], [-18, 30, 1], [2, 0, 0.0]]))
    points = clouds.scan(np.random.default_rng(1), flat.centres, flat.diameters, plate_z=plate, plate_tilt=tilt, spacing=0.3)
    check(find_spheres(points, flat), flat.centres, flat)


def test_order_of_points_does_not_matter(cloud):
    shuffled = np.random.default_rng(4).permutation(cloud)
    a, b = find_spheres(cloud, MBC), find_spheres(shuffled, MBC)
    np.testing.assert_array_equal(a.ball, b.ball)
    np.testing.assert_allclose(a.xyz, b.xyz, atol=2e-5)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
    angle=st.floats(0, 180),
    shift=st.tuples(*[st.floats(-300, 300)] * 3),
)
@example(axis=(0.8962761184025689, -0.35, 0.0), angle=98.375, shift=(0.0, 0.0, 0.0))  # all votes for a ball in the corner of a window
def test_the_answer_moves_with_the_cloud(cloud, centres_found, axis, angle, shift):
    R = clouds.rotation(axis, angle)
    moved = find_spheres(cloud.astype(float) @ R.T + shift, MBC)
    np.testing.assert_array_equal(moved.ball, MBC.ball_ids)
    np.testing.assert_allclose(moved.xyz, centres_found @ R.T + shift, atol=5e-5)


@pytest.mark.parametrize("spacing", [0.12, 0.6, 0.9])
def test_dense_and_sparse_clouds(spacing):
    points = clouds.scan(np.random.default_rng(6), CENTRES, MBC.diameters, spacing=spacing)
    check(find_spheres(points, MBC), CENTRES)


def test_rows_that_are_not_finite_are_left_out(cloud):
    holes = cloud.copy()
    holes[::7] = np.nan
    holes[3] = np.inf
    check(find_spheres(holes, MBC), CENTRES)


def test_stray_points_far_away_do_not_matter(cloud):
    stray = np.random.default_rng(1).uniform(-4000, 4000, (2000, 3)).astype(np.float32)
    check(find_spheres(np.concatenate([cloud, stray]), MBC), CENTRES)


@pytest.mark.parametrize("scale", [0.9997, 1.0003, 1.00035])
def test_a_scanner_scale_error_or_a_warm_artefact_is_not_refused(scale):
    points = clouds.scan(np.random.default_rng(2), CENTRES * scale, MBC.diameters * scale, spacing=0.3)
    found = find_spheres(points, MBC)
    assert tuple(found.ball) == MBC.ball_ids
    assert found.refused == []


def test_a_ball_displaced_on_its_stem_is_still_recognised():
    centres = CENTRES.copy()
    centres[4] += [0.09, -0.06, 0.04]
    found = find_spheres(clouds.scan(np.random.default_rng(2), centres, MBC.diameters, spacing=0.3), MBC)
    check(found, centres)


def test_covered_balls_are_absent():
    shown = [0, 2, 3, 6]
    points = clouds.scan(np.random.default_rng(3), CENTRES[shown], MBC.diameters[shown], spacing=0.3)
    check(find_spheres(points, MBC), CENTRES, ids=(1, 3, 4, 7))


def test_an_expected_ball_that_is_covered_is_named(cloud):
    shown = [0, 1, 2, 3, 4, 5, 6]
    points = clouds.scan(np.random.default_rng(3), CENTRES[shown], MBC.diameters[shown], spacing=0.3)
    found = find_spheres(points, MBC, expected=MBC.ball_ids)
    assert tuple(found.ball) == (1, 2, 3, 4, 5, 6, 7)
    assert [reason for reason, _ in found.refused] == ["ball 8 was expected and is not seen"]


def test_a_ball_of_which_a_sliver_is_measured_is_not_used(cloud):
    sliver = CENTRES[7]
    near = np.linalg.norm(cloud - sliver, axis=1) < 7
    points = cloud[~near | (cloud[:, 0] > sliver[0] + 3.9)]
    found = find_spheres(points, MBC)
    assert 8 not in found.ball
    check(found, CENTRES, ids=(1, 2, 3, 4, 5, 6, 7))


def test_two_balls_that_touch_are_two_balls():
    close = clouds.make(np.array([[-6, 0, 0], [6, 0, 0], [30, 20, 0], [-25, 30, 0.0]]))
    check(find_spheres(clouds.scan(np.random.default_rng(9), close.centres, 12.0, spacing=0.25), close), close.centres, close)


def test_balls_of_two_diameters():
    mixed = clouds.make(np.array([[-20, 0, 0], [20, 0, 0], [0, 30, 0], [0, -30, 0.0]]), diameter=np.array([12.0, 16.0, 12.0, 16.0]))
    check(find_spheres(clouds.scan(np.random.default_rng(9), mixed.centres, mixed.diameters, spacing=0.3), mixed), mixed.centres, mixed)


def test_a_stray_ball_in_view_is_refused_and_the_rest_used(cloud):
    stray = np.array([[50.0, 50.0, 0.0]])
    points = clouds.scan(np.random.default_rng(3), np.concatenate([CENTRES, stray]), 12.0, spacing=0.3)
    found = find_spheres(points, MBC)
    check(found, CENTRES)
    ((reason, where),) = found.refused
    assert "does not belong" in reason
    np.testing.assert_allclose(where, stray[0], atol=0.01)


def test_an_empty_view_gives_no_ball():
    assert len(find_spheres(np.empty((0, 3), np.float32), MBC)) == 0
    plate = clouds.scan(np.random.default_rng(3), np.empty((0, 3)), [], spacing=0.4)
    assert len(find_spheres(plate, MBC)) == 0


@pytest.mark.parametrize("noise", [0.003, 0.03])
def test_quiet_and_noisy_scanners(noise):
    found = find_spheres(clouds.scan(np.random.default_rng(3), CENTRES, 12.0, spacing=0.3, noise=noise), MBC)
    assert tuple(found.ball) == MBC.ball_ids
    assert np.abs(found.xyz - CENTRES).max() < 0.25 * noise


def test_wrong_artefact_is_refused_with_what_was_found_and_expected():
    other = clouds.artefact(seed=77)
    points = clouds.scan(np.random.default_rng(3), other.centres, 12.0, spacing=0.3)
    with pytest.raises(DeviceFault, match=r"wrong artefact in view: 8 balls with the distances .* mm are seen.*artefact 'mbc' with .* mm"):
        find_spheres(points, MBC)


def test_the_mirror_image_is_refused():
    points = clouds.scan(np.random.default_rng(3), CENTRES * [1, -1, 1], 12.0, spacing=0.3)
    with pytest.raises(DeviceFault, match="mirror image"):
        find_spheres(points, MBC)


@pytest.mark.parametrize("diameter", [10.0, 12.7, 16.0, 25.0])
def test_balls_of_another_diameter_are_refused(diameter):
    wide = clouds.make(np.array([[-28, -20, 0], [28, -25, 1], [30, 25, 0], [-25, 30, 1.0]]))
    points = clouds.scan(np.random.default_rng(3), wide.centres, diameter, spacing=0.3)
    with pytest.raises(DeviceFault, match="wrong artefact in view") as error:
        find_spheres(points, wide)
    assert f"{diameter:.1f}" in str(error.value)


def test_a_symmetric_artefact_is_ambiguous():
    square = clouds.make(np.array([[-20, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0.0]]))
    points = clouds.scan(np.random.default_rng(3), square.centres, 12.0, spacing=0.3)
    with pytest.raises(DeviceFault, match="cannot tell which ball is which"):
        find_spheres(points, square)
    check(find_spheres(points, square, predicted=square.centres + [6.0, -4.0, 3.0]), square.centres, square)


def test_tenths_of_a_millimetre_identify_a_nearly_symmetric_artefact():
    nearly = clouds.make(np.array([[-20, -20, 0], [20.15, -20, 0], [20, 20, 0.0], [-20, 20.1, 0.1], [0, 0, 5]]))
    points = clouds.scan(np.random.default_rng(3), nearly.centres, 12.0, spacing=0.3)
    check(find_spheres(points, nearly), nearly.centres, nearly)


def test_certificate_and_expectation_are_checked(cloud):
    with pytest.raises(ConfigError, match="ball 99 is expected"):
        find_spheres(cloud, MBC, expected=[1, 99])
    with pytest.raises(ConfigError, match="diameter_mm"):
        find_spheres(cloud, clouds.make(MBC.centres, 0.0))
    with pytest.raises(ConfigError, match="shape"):
        find_spheres(cloud[:, :2], MBC)
    with pytest.raises(ConfigError, match="predicted"):
        find_spheres(cloud, MBC, expected=[1], predicted=np.zeros((2, 3)))


def test_the_view_may_be_given(cloud):
    check(find_spheres(cloud, MBC, options=SphereOptions(view=(0, 0, 2.0))), CENTRES)
