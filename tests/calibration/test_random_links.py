"""Links whose errors have a common size: near the nominal arm where poses say nothing, as measured where they say everything."""

import numpy as np
import pytest
from cells import kr10, random_errors, scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation.adjustment import adjust_recording, with_random_links
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.variance_components import pack
from mbcacq.geometry import se3

FREE = CalibrationOptions(random_links=False, discrepancy=False, refuse=False)
RANDOM = CalibrationOptions(discrepancy=False, refuse=False)


def cell(seed, joint_rad, **of):
    rng = np.random.default_rng([3, seed])
    return scanner_cell(rng, joint_rad=joint_rad, errors=of.pop("errors", random_errors(kr10(), rng)), **of)


def off_elsewhere(found, truth):
    """3D rms (mm) of a point 265 mm before the flange at 200 postures, a rigid motion of everything aside."""
    q = np.random.default_rng(1).uniform(-1, 1, size=(200, 6)) * [1.2, 0.5, 0.5, 1.5, 1.0, 2.0] + [0, -1.2, 1.5, 0, 0, 0]
    a, b = (s.chain.frames(q)[:, -1] @ s.T_flange_scanner @ [0, 0, 265.0, 1] for s in (found.state, truth))
    a, b = a[:, :3] - a[:, :3].mean(axis=0), b[:, :3] - b[:, :3].mean(axis=0)
    R = se3.nearest_rotation(b.T @ a)
    return float(np.sqrt(np.mean(np.sum((a @ R.T - b) ** 2, axis=1))))


def test_few_poses_of_an_arm_do_not_throw_it_off_at_other_places():
    """Twenty-five poses at five places, joints that repeat within 80 urad: free links are worse there than the nominal arm."""
    free, random, nominal = [], [], []
    for seed in range(3):
        made = cell(seed, 8e-5, stations=5, per_station=5)
        free.append(off_elsewhere(calibrate(made.observations, FREE), made.truth))
        random.append(off_elsewhere(calibrate(made.observations, RANDOM), made.truth))
        nominal.append(off_elsewhere(calibrate(made.observations, CalibrationOptions(kinematics=False, refuse=False)), made.truth))
    assert np.median(random) < 0.4 * np.median(free)
    assert np.median(random) < 0.7 * np.median(nominal)


def test_poses_that_determine_everything_are_believed():
    made = cell(0, 1e-7, stations=12, per_station=8, noise=(1e-4, 1e-4, 1e-4))
    free, random = (calibrate(made.observations, options) for options in (FREE, RANDOM))
    np.testing.assert_allclose(random.state.chain.rows, free.state.chain.rows, atol=2e-3)
    assert off_elsewhere(random, made.truth) < 2e-3


def test_one_joint_that_was_mastered_wrongly_is_found_among_good_ones():
    errors = random_errors(kr10(), np.random.default_rng(8), 0.2)
    errors[3, 0] = np.radians(1.0)
    made = cell(1, 8e-6, errors=errors)
    found = next(p for p in calibrate(made.observations, RANDOM).parameters if p.name == "theta_4")
    assert found.error == pytest.approx(np.radians(1.0), abs=4 * found.std)
    assert found.std < np.radians(0.02)


def test_the_sizes_are_those_of_the_arm_and_the_parameters_say_that_they_have_one():
    made = cell(2, 8e-6, stations=20, per_station=8)
    found = calibrate(made.observations, RANDOM)
    chain = found.layout.blocks[0]
    size = {group: sigma for group, sigma, free in zip(chain.group, chain.sigma, chain.free, strict=True) if free}
    group = np.array(chain.group)
    for name, sigma in size.items():
        true = np.sqrt(np.mean(made.errors.ravel()[chain.free & (group == name)] ** 2))
        assert true / 2 < sigma < 2 * true  # a size is estimated from four to eleven links
    assert {p.status for p in found.parameters if p.name.startswith(("theta", "d_", "a_"))} <= {"prior", "held"}


def test_stated_uncertainties_cover_the_error_of_each_link():
    z = []
    for seed in range(6):
        made = cell(20 + seed, 8e-5, stations=6, per_station=6)
        found = calibrate(made.observations, RANDOM)
        error = dict(zip(found.layout.blocks[0].names, made.errors.ravel(), strict=True))
        z += [(p.error - error[p.name]) / p.std for p in found.parameters if p.name in error and p.std is not None]
    assert 0.9 < np.mean(np.abs(z) < 2) < 0.99  # 0.954 for a normal distribution


def test_noise_that_was_settled_roughly_with_free_links_is_settled_with_random_ones():
    obs = cell(4, 8e-6, stations=8, per_station=8).observations
    rough, fine = (adjust_recording(obs, RANDOM, links_follow=follow) for follow in (True, False))
    assert not np.allclose(pack(rough.noise), pack(fine.noise), atol=1e-5)
    found, same = with_random_links(rough), with_random_links(fine)
    np.testing.assert_allclose(pack(found.noise), pack(same.noise), atol=2e-3)
    off = (found.state.chain.rows - same.state.chain.rows).ravel()[found.lineariser.layout.blocks[0].free]
    sigma = np.sqrt(np.diag(np.linalg.inv(same.solution.normal.information)))[: len(off)]
    assert np.all(np.abs(off) < 0.01 * sigma)


def test_links_are_free_where_arms_are_compared():
    made = cell(4, 8e-6)
    assert {p.status for p in calibrate(made.observations, FREE).parameters if p.name.startswith("a_")} <= {"free", "held"}
