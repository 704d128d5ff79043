"""Measured recordings of other laboratories, and made data of an independent simulation with its truth beside it."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.cross_validation import held_out
from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.recording import load_observations

DATA = Path(__file__).parents[3] / "shared" / "data"
GEOMETRY = CalibrationOptions(discrepancy=False)  # a thirtieth of the time, for what does not depend on smooth errors of the joints
pytestmark = [pytest.mark.shared_data, pytest.mark.skipif(not DATA.is_dir(), reason="the shared data folder is not there")]


def test_independent_simulation_is_explained_down_to_its_noise():
    obs = load_observations(DATA / "example-none")
    found = calibrate(obs)
    assert found.fit.rejected == ()
    assert found.fit.chi2 / found.fit.dof == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(found.noise.point, obs.cell.noise_mm, rtol=0.12)
    truth = json.loads((DATA / "example-none.truth.json").read_text())
    nominal = obs.cell.robot.chain
    chain = Chain(nominal.sign, *(nominal.rows + np.array(truth["geometry"])).T)
    # Base and stations may move together (theta_1, d_1): compare how points lie to each other, over the poses measured.
    xyz = np.tile([5.0, -3.0, 2.0], (obs.n_poses, 1))
    there = se3.apply(chain.flange(obs.q) @ np.array(truth["hand_eye"]), xyz)
    here = found.placed(obs.q, xyz)
    centred = there - there.mean(0), here - here.mean(0)
    R = se3.nearest_rotation(centred[0].T @ centred[1])
    off = centred[1] @ R.T - centred[0]
    expected = np.sqrt(np.mean(np.trace(found.point_covariance(obs.q, xyz), axis1=1, axis2=2)))
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 2 * expected < 0.05


def test_held_out_stations_of_a_clean_cell_show_the_noise_only():
    figure = held_out(load_observations(DATA / "example-none"), split="station")
    assert figure.fits == 16
    assert 0.0110 < figure.rms_mm < 0.0135


def test_ur5_with_a_laser_tracker():
    figure = held_out(load_observations(DATA / "ur5-tracker"), GEOMETRY, split="random", size=300, fits=2)
    assert figure.poses == 600
    assert figure.rms_mm <= 0.118


def test_smooth_errors_predict_a_ur5_better_than_geometry_alone():
    smooth, alone = (held_out(every("ur5-tracker", 3), of, split="random", size=100, fits=1) for of in (None, GEOMETRY))
    assert smooth.rms_mm < 0.7 * alone.rms_mm


def test_a_random_split_is_the_same_again():
    two = held_out(every("ur5-tracker", 6), GEOMETRY, split="random", size=40, fits=2)
    again = held_out(every("ur5-tracker", 6), GEOMETRY, split="random", size=40, fits=1)
    assert again.per_fit_mm == two.per_fit_mm[:1]


def every(name, nth):
    """Every second, third .. pose of a recording: its facts in a part of the time."""
    whole = load_observations(DATA / name)
    return whole.select(np.arange(whole.n_poses) % nth == 0)


def test_panda_in_sockets():
    figure = held_out(every("panda-sockets", 3), split="station")
    assert figure.fits == 6
    assert figure.spread_mm <= 0.19
    assert figure.rms_mm > figure.spread_mm  # the six freedoms of a place are paid for


def test_blocks_are_judged_only_where_training_knows_the_socket():
    recording = every("panda-sockets", 3)
    figure = held_out(recording, GEOMETRY, split="block")
    assert figure.fits == 5
    assert figure.poses < recording.n_poses
    assert figure.rms_mm < 0.3


def test_iiwa_in_sockets_names_what_a_ball_near_the_last_axis_leaves_open():
    found = calibrate(load_observations(DATA / "iiwa14-sockets"), GEOMETRY)
    assert {u.name for u in found.fit.undetermined} == {"a_6", "alpha_6"}
    assert all(u.harmless for u in found.fit.undetermined)
    assert {"hand_eye.rx", "hand_eye.ry", "hand_eye.rz", "theta_7"} <= set(found.layout.held)
    assert found.fit.rms_mm < 0.25


def test_a_target_with_orientation():
    found = calibrate(every("ur10-tracker-c", 32))
    assert found.fit.residual.shape[1] == 6
    assert found.fit.rms_mm < 0.52
    assert found.fit.chi2 / found.fit.dof == pytest.approx(1, abs=0.05)


def test_command_line():
    answer = CliRunner().invoke(app, ["calibrate", str(DATA / "example-none"), "--json", "--held-out", "station"], standalone_mode=False)
    result = json.loads(answer.stdout)
    assert result["format"] == "mbcacq-result/1"
    assert result["verification"]["after"]["max_mm"] < 0.02 < result["verification"]["before"]["max_mm"]
    assert not result["verification"]["independent"]
    assert result["held_out"]["split"] == "station"
    shown = CliRunner().invoke(app, ["calibrate", str(DATA / "ur5-tracker"), "--geometry-alone"], standalone_mode=False).stdout
    assert "Universal Robots UR5" in shown
    assert "only the target's position is measured" in shown


def test_one_station_cannot_be_left_out():
    with pytest.raises(Exception, match="one station only"):
        held_out(load_observations(DATA / "ur5-tracker"), split="station")
    with pytest.raises(ConfigError, match="no held-out split"):
        held_out(load_observations(DATA / "ur5-tracker"), CalibrationOptions(), "half")
