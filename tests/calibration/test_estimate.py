"""A known truth is recovered; the covariance says by how much it is missed; what must not matter does not matter."""

from dataclasses import replace

import numpy as np
import pytest
from cells import iiwa, measure, scanner_cell, tracker_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.calibration.result_io import state_from_dict
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.terms import Part, term
from mbcacq.geometry import se3
from mbcacq.model.cell import Station

NOISE = (0.005, 0.005, 0.009)


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(11), stations=8, per_station=6, bars=4)


def test_truth_is_recovered_without_noise():
    cell = scanner_cell(np.random.default_rng(1), noise=(1e-6, 1e-6, 1e-6), joint_rad=1e-9, stated=False)
    found = calibrate(cell.observations, CalibrationOptions(balls=False))
    np.testing.assert_allclose(found.errors, cell.errors, atol=2e-4)
    np.testing.assert_allclose(found.state.T_flange_scanner, cell.truth.T_flange_scanner, atol=1e-4)
    np.testing.assert_allclose(found.state.T_base_station, cell.truth.T_base_station, atol=2e-3)
    assert found.fit.rank == 24 + 6 * 8


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("options", [CalibrationOptions(), CalibrationOptions(method="paper", pairs="all")], ids=["ml", "paper"])
def test_data_without_any_noise_give_no_negative_variance(options):
    """The information then spans more digits than a double has; what is stated for the noise ends at 10 nm and 1 nrad."""
    cell = scanner_cell(np.random.default_rng(1), noise=(0, 0, 0), joint_rad=0, preliminary=True)
    found = calibrate(cell.observations, options)
    assert np.all(np.diag(found.covariance) >= 0)
    result = found.to_dict()
    assert all(np.isfinite(p["std"]) for p in result["parameters"] if p["std"] is not None)
    assert all(abs(c["correlation"]) <= 1 + 1e-9 for c in result["correlated"])
    np.testing.assert_allclose(found.noise.point, 1e-5, rtol=1e-6)
    if options.method == "ml":
        np.testing.assert_allclose(found.errors, cell.errors, atol=1e-7)


def test_normalised_errors_follow_chi_square(cell):
    """Monte Carlo: d' inv(C) d of all free parameters has mean g, within its sampling error."""
    rng = np.random.default_rng(2)
    base = cell.observations.select(cell.observations.phase != "verification")
    values, factors = [], []
    for _ in range(40):
        found = calibrate(measure(base, cell.truth, rng, NOISE, 8e-6))
        off = np.concatenate(
            [
                (found.errors - cell.errors).reshape(-1),
                _twist(se3.inverse(cell.truth.T_flange_scanner) @ found.state.T_flange_scanner),
                (found.state.balls - cell.truth.balls).reshape(-1),
            ]
        )
        free = np.concatenate([b.free for b in found.layout.blocks[:3]])
        arm = slice(0, 24)
        d = off[free][arm]
        values.append(d @ np.linalg.solve(found.covariance[arm, arm], d))
        factors.append(found.fit.chi2 / found.fit.dof)
    assert np.mean(values) == pytest.approx(24, abs=4 * np.sqrt(2 * 24 / 40))
    assert np.mean(factors) == pytest.approx(1.0, abs=0.02)


def test_expected_bar_error_is_met_on_average(cell):
    rng = np.random.default_rng(3)
    ratio = []
    for _ in range(25):
        obs = measure(cell.observations, cell.truth, rng, NOISE, 8e-6)
        checked = verify(obs, calibrate(obs))
        assert checked.independent
        ratio.append(checked.errors("after") / np.array([p.expected_mm for p in checked.places]))
    assert 0.75 < np.sqrt(np.mean(np.square(ratio))) < 1.3


def test_noise_is_estimated():
    cell = scanner_cell(np.random.default_rng(4), stations=12, per_station=8, noise=(0.004, 0.006, 0.012), joint_rad=2e-5, stated=False)
    noise = calibrate(cell.observations).noise
    np.testing.assert_allclose(noise.point, [0.004, 0.006, 0.012], rtol=0.1)
    np.testing.assert_allclose(noise.joint, 2e-5, rtol=0.25)


def test_a_stated_noise_that_is_wrong_shows_in_the_check_factor():
    cell = scanner_cell(np.random.default_rng(5), noise=(0.02, 0.02, 0.036))
    obs = replace(cell.observations, cell=replace(cell.observations.cell, noise_mm=np.array(NOISE)))
    result = calibrate(obs).to_dict()
    np.testing.assert_allclose(result["noise"]["check_factor"], 4, rtol=0.15)


def test_seven_axes():
    cell = scanner_cell(np.random.default_rng(6), chain=iiwa(), stations=10, per_station=6, noise=(1e-5,) * 3, joint_rad=1e-8, stated=False)
    found = calibrate(cell.observations, CalibrationOptions(balls=False))
    np.testing.assert_allclose(found.errors, cell.errors, atol=1e-3)


@pytest.mark.parametrize("orientation", [False, True])
def test_tracker(orientation):
    cell = tracker_cell(np.random.default_rng(7), orientation=orientation, joint_rad=1e-5)
    found = calibrate(cell.observations)
    off = (found.errors - cell.errors).reshape(-1)[found.layout.blocks[0].free]
    d = off @ np.linalg.solve(found.covariance[: len(off), : len(off)], off)
    assert d < len(off) + 5 * np.sqrt(2 * len(off))
    assert found.fit.chi2 / found.fit.dof == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(found.state.T_base_station, cell.truth.T_base_station, atol=0.1)


def test_first_guess_may_be_far_off(cell):
    near = calibrate(cell.observations)
    wrong = cell.observations.cell.T_flange_scanner @ se3.exp(np.array([100.0, -60, 80, 0.3, -0.2, 0.15]))
    far = calibrate(replace(cell.observations, cell=replace(cell.observations.cell, T_flange_scanner=wrong)))
    np.testing.assert_allclose(far.state.T_flange_scanner, near.state.T_flange_scanner, atol=1e-5)
    np.testing.assert_allclose(far.errors, near.errors, atol=1e-5)


def test_order_of_poses_and_stations_does_not_matter(cell):
    obs = replace(cell.observations, time_s=np.arange(float(cell.observations.n_poses)))
    rng = np.random.default_rng(8)
    order, relabel = rng.permutation(obs.n_poses), rng.permutation(len(obs.cell.stations))
    place = np.argsort(order)
    rows = np.argsort(place[obs.pose], kind="stable")
    inverse = np.argsort(relabel)
    shuffled = replace(
        obs,
        cell=replace(obs.cell, stations=tuple(obs.cell.stations[i] for i in relabel)),
        pose_id=obs.pose_id[order],
        station=inverse[obs.station[order]],
        q=obs.q[order],
        phase=obs.phase[order],
        time_s=obs.time_s[order],
        pose=place[obs.pose][rows],
        ball=obs.ball[rows],
        xyz=obs.xyz[rows],
    )
    one, two = calibrate(obs), calibrate(shuffled)
    np.testing.assert_allclose(two.errors, one.errors, atol=1e-6)
    np.testing.assert_allclose(two.state.T_base_station[inverse][:8], one.state.T_base_station[:8], atol=1e-5)
    np.testing.assert_allclose(two.covariance, one.covariance, rtol=1e-3, atol=1e-12)


def test_frame_of_the_instrument_and_of_the_artefact_do_not_matter():
    cell = tracker_cell(np.random.default_rng(9))
    T = se3.exp(np.array([500.0, 20, -900, 0.5, -1.0, 0.7]))
    moved = calibrate(replace(cell.observations, xyz=se3.apply(T, cell.observations.xyz)))
    still = calibrate(cell.observations)
    np.testing.assert_allclose(moved.state.T_base_station[0] @ T, still.state.T_base_station[0], atol=0.05)
    # The noise is estimated axis by axis, so a turn of the axes changes weights a little.
    np.testing.assert_allclose(moved.errors, still.errors, atol=0.01)


def test_a_known_station_frees_the_base():
    cell = scanner_cell(np.random.default_rng(10), stations=6)
    stations = tuple(Station(s.id, s.artefact, cell.truth.T_base_station[i], 0.01) for i, s in enumerate(cell.observations.cell.stations))
    found = calibrate(replace(cell.observations, cell=replace(cell.observations.cell, stations=stations)))
    assert {"theta_1", "d_1"} <= set(found.names)
    np.testing.assert_allclose(found.state.T_base_station[:, :3, 3], cell.truth.T_base_station[:, :3, 3], atol=0.05)
    std = np.sqrt(np.diag(found.covariance))[found.names.index("d_1")]
    assert abs(found.errors[0, 1]) < 4 * std < 0.1


def test_effects_are_estimated_with_everything_else(cell):
    obs = cell.observations
    scale = term("scale", [Part("joint", 1, 0, obs.q[:, 1:2]), Part("joint", 2, 0, np.zeros((obs.n_poses, 1)))], units="rad/rad")
    bent = replace(obs, q=obs.q / (1 + np.array([0, 1e-3, 0, 0, 0, 0])))
    used = bent.phase != "verification"
    scale = replace(
        scale, parts=tuple(replace(p, basis=(bent.q[used, 1:2] if p.index == 1 else np.zeros((used.sum(), 1)))) for p in scale.parts)
    )
    found = calibrate(bent, CalibrationOptions(terms=(scale,)))
    std = np.sqrt(found.covariance[-1, -1])
    assert found.names[-1] == "scale"
    assert found.fit.coefficients[0][0] == pytest.approx(1e-3, abs=4 * std)
    assert std < 2e-4


def test_result_file_round_trip(cell):
    import json

    found = calibrate(cell.observations)
    result = json.loads(json.dumps(found.to_dict()))
    again = state_from_dict(result, cell.observations.cell)
    np.testing.assert_array_equal(again.chain.rows, found.state.chain.rows)
    np.testing.assert_array_equal(again.T_flange_scanner, found.state.T_flange_scanner)
    np.testing.assert_array_equal(again.balls, found.state.balls)
    free = [p for p in result["parameters"] if p["status"] != "held"]
    assert [p["name"] for p in free] == result["names"]
    assert np.shape(result["covariance"]) == (len(free), len(free))


def _twist(T):
    return np.concatenate([T[:3, 3], se3.rotation_log(T[:3, :3])])
