"""Outliers are found and named; recordings that cannot determine a cell are refused with the reason."""

from dataclasses import replace

import numpy as np
import pytest
from cells import measure, scanner_cell, tracker_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.options import CalibrationOptions


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(21), stations=8, per_station=8)


def same_as_clean(found, clean):
    """Within two standard deviations of the fit without the fault."""
    std = np.sqrt(np.diag(clean.covariance))[:18]
    free = clean.layout.blocks[0].free
    return np.all(np.abs((found.errors - clean.errors).reshape(-1)[free]) < 2 * std)


def test_clean_data_lose_nothing(cell):
    assert calibrate(cell.observations).fit.rejected == ()


def test_a_mistaken_ball_is_found(cell):
    obs = cell.observations
    ball = obs.ball.copy()
    rows = np.flatnonzero(obs.pose == 10)
    ball[rows[2]], ball[rows[5]] = ball[rows[5]], ball[rows[2]]
    found = calibrate(replace(obs, ball=ball))
    assert {(r.pose, r.ball) for r in found.fit.rejected} == {(10, ball[rows[2]] + 1), (10, ball[rows[5]] + 1)}
    assert same_as_clean(found, calibrate(obs))


def test_a_bumped_tripod_and_a_wrong_pose_are_found(cell):
    obs = cell.observations
    xyz, q = obs.xyz.copy(), obs.q.copy()
    for pose in (22, 23):
        xyz[obs.pose == pose] += [0.4, -0.2, 0.3]
    q[40] += [0, 0.01, 0, 0, 0, 0]
    found = calibrate(replace(obs, xyz=xyz, q=q))
    assert {(r.pose, r.ball) for r in found.fit.rejected} == {(22, None), (23, None), (40, None)}
    assert same_as_clean(found, calibrate(obs))


def test_one_percent_of_gross_outliers(cell):
    obs = cell.observations
    rng = np.random.default_rng(1)
    bad = rng.choice(obs.n_centres, obs.n_centres // 100 + 1, replace=False)
    xyz = obs.xyz.copy()
    xyz[bad] += rng.normal(size=(len(bad), 3)) * 20
    found = calibrate(replace(obs, xyz=xyz))
    assert set(np.flatnonzero(found.fit.weights.centre == 0)) == set(bad)
    assert same_as_clean(found, calibrate(obs))


def test_gross_outliers_of_a_tracker():
    obs = tracker_cell(np.random.default_rng(2), poses=1000, joint_rad=1e-5).observations
    xyz = obs.xyz.copy()
    xyz[[5, 500]] += [[80.0, 0, 0], [0, -3.0, 2.0]]
    found = calibrate(replace(obs, xyz=xyz))
    assert {r.pose for r in found.fit.rejected} == {5, 500}


def test_one_orientation_only_is_refused():
    obs = scanner_cell(np.random.default_rng(3), tilt_deg=0.01).observations
    with pytest.raises(CalibrationError, match="same orientation"):
        calibrate(obs)


def test_all_poses_at_one_station_are_refused(cell):
    obs = cell.observations
    with pytest.raises(CalibrationError, match="all poses are at one station"):
        calibrate(obs.select(obs.station == 0))
    hand_eye = calibrate(obs.select(obs.station == 0), CalibrationOptions(kinematics=False))
    assert np.linalg.norm(hand_eye.state.T_flange_scanner[:3, 3] - obs.cell.T_flange_scanner[:3, 3]) < 10


def test_two_visible_balls_are_refused(cell):
    obs = cell.observations
    two = obs.ball < 2
    with pytest.raises(CalibrationError, match="three balls"):
        calibrate(replace(obs, pose=obs.pose[two], ball=obs.ball[two], xyz=obs.xyz[two]))


def test_a_joint_that_never_moved_is_named():
    rng = np.random.default_rng(4)
    cell = tracker_cell(rng)
    q = cell.observations.q.copy()
    q[:, 2] = 0.7
    with pytest.raises(CalibrationError, match="do not determine .*_[23]"):
        calibrate(measure(replace(cell.observations, q=q), cell.truth, rng, (0.02, 0.02, 0.02), 1e-5))


def test_too_few_measurements_are_refused(cell):
    obs = cell.observations
    with pytest.raises(CalibrationError, match="18 coordinates for 30 unknowns"):
        calibrate(tracker_cell(np.random.default_rng(6), poses=6).observations)
    with pytest.raises(CalibrationError):
        calibrate(obs.select(np.isin(np.arange(obs.n_poses), [0, 1])), CalibrationOptions())
    with pytest.raises(ConfigError, match="no pose of phase translation"):
        calibrate(obs, CalibrationOptions(phases=("translation",)))


def test_contradictory_data_are_refused(cell):
    """Joint angles of other poses: most of the measurements contradict the rest, whatever is done."""
    obs = cell.observations
    rng = np.random.default_rng(5)
    with pytest.raises(CalibrationError, match="miss each other"):
        calibrate(replace(obs, q=obs.q[rng.permutation(obs.n_poses)]))


def test_unknown_names_are_refused(cell):
    with pytest.raises(ConfigError, match="no parameter 'd_9'"):
        calibrate(cell.observations, CalibrationOptions(hold=("d_9",)))
    with pytest.raises(ConfigError, match="no calibration method"):
        CalibrationOptions(method="magic")


def test_an_absurd_coordinate_is_refused_in_one_sentence(shared_data):
    """One coordinate of 1e30: too far from everything even for the outlier screen's arithmetic."""
    from mbcacq.recording import load_observations

    observations = load_observations(shared_data / "example-none")
    xyz = observations.xyz.copy()
    xyz[3, 0] = 1e30
    with pytest.raises(CalibrationError):
        calibrate(replace(observations, xyz=xyz))


def test_parameters_that_run_away_are_named():
    from mbcacq.calibration.sufficiency import refuse_runaway
    from mbcacq.geometry.chain import Chain

    nominal = Chain(*np.ones((6, 6)))
    errors = np.zeros((6, 5))
    errors[3, 4] = np.radians(0.5)
    refuse_runaway(nominal.with_errors(errors), nominal, CalibrationOptions())
    errors[1, 2] = -7.0
    with pytest.raises(CalibrationError, match="a_2"):
        refuse_runaway(nominal.with_errors(errors), nominal, CalibrationOptions())
    refuse_runaway(nominal.with_errors(errors), nominal, CalibrationOptions(refuse=False))
