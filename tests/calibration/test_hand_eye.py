"""Hand-eye calibration as most people have it: poses of the flange, target poses, fixed scanners, one sphere, no certificate."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hand_eye_data import ARTEFACT_IN_SCANNER, BALLS, TARGET_IN_BASE, local_error, recording

import mbcacq
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.compare_methods import compare
from mbcacq.calibration.hand_eye_equations import MOTION_METHODS, POSE_METHODS, motions
from mbcacq.calibration.sufficiency import options_for
from mbcacq.cli.calibrate import command as calibrate_command
from mbcacq.cli.calibrate import next_of_flange_poses
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_coordinates, flange_transforms
from mbcacq.geometry.orientations import to_matrices, to_numbers
from mbcacq.model.cell import KnownLength
from mbcacq.recording.datasets.observation_set import write_observation_set
from mbcacq.recording.datasets.uncertified import with_estimated_centres

ALONE = mbcacq.CalibrationOptions(kinematics=False)
HAND_EYE = ("x", "y", "z", "rx", "ry", "rz")
OPENCV = {"Tsai-Lenz": "TSAI", "Park-Martin": "PARK", "Horaud-Dornaika": "HORAUD", "Andreff": "ANDREFF", "Daniilidis": "DANIILIDIS"}


def both_sides(rng, poses=15, noise=0.0):
    X, Z = (se3.transform(se3.rotation_exp(rng.normal(size=3)), 100 * rng.normal(size=3)) for _ in range(2))
    F = se3.transform(se3.rotation_exp(0.6 * rng.normal(size=(poses, 3))), 200 * rng.normal(size=(poses, 3)))
    C = se3.inverse(F @ X) @ Z @ se3.exp(noise * rng.normal(size=(poses, 6)) * [0.1, 0.1, 0.1, 3e-4, 3e-4, 3e-4])
    return X, Z, F, C


def by_equations(name, F, C):
    if name in MOTION_METHODS:
        return MOTION_METHODS[name](*motions(F, C, np.zeros(len(F), int)))
    return se3.inverse(POSE_METHODS[name](C, se3.inverse(F))[1])


@pytest.mark.parametrize("name", [*MOTION_METHODS, *POSE_METHODS])
def test_each_closed_form_finds_the_transform_of_exact_poses(name):
    X, _, F, C = both_sides(np.random.default_rng(4))
    np.testing.assert_allclose(by_equations(name, F, C), X, atol=1e-9)


@pytest.mark.parametrize("name", [*MOTION_METHODS, *POSE_METHODS])
def test_each_closed_form_agrees_with_opencv(name):
    cv2 = pytest.importorskip("cv2")
    off, theirs_off, apart = [], [], []
    for seed in range(20):
        X, _, F, C = both_sides(np.random.default_rng(seed), noise=1.0)
        ours = by_equations(name, F, C)
        if name in OPENCV:
            parts = [list(M[:, :3, :3]) if k == 0 else list(M[:, :3, 3]) for M in (F, C) for k in (0, 1)]
            R, t = cv2.calibrateHandEye(*parts, method=getattr(cv2, f"CALIB_HAND_EYE_{OPENCV[name]}"))
            theirs = se3.transform(R, t.ravel())
        else:
            back = se3.inverse(F)
            method = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{name.upper()}")
            parts = [list(M[:, :3, :3]) if k == 0 else list(M[:, :3, 3]) for M in (C, back) for k in (0, 1)]
            R, t = cv2.calibrateRobotWorldHandEye(*parts, method=method)[2:]
            theirs = se3.inverse(se3.transform(R, t.ravel()))
        off.append(np.linalg.norm(ours[:3, 3] - X[:3, 3]))
        theirs_off.append(np.linalg.norm(theirs[:3, 3] - X[:3, 3]))
        apart.append(np.linalg.norm(ours[:3, 3] - theirs[:3, 3]))
    if name in ("Park-Martin", "Horaud-Dornaika", "Daniilidis", "Shah"):
        assert max(apart) < 1e-9
    else:  # the same equations, other weights of motions or another last step
        assert np.sqrt(np.mean(np.square(off))) < 1.1 * np.sqrt(np.mean(np.square(theirs_off)))


def found_and_covariance(r, measurement):
    obs = with_estimated_centres(r.observations, "test")
    c = mbcacq.calibrate(obs, ALONE)
    if measurement == TARGET_IN_BASE:
        return local_error(c.state.T_base_station[0], r.T_base_station), c.fit.station_covariance[0]
    at = [c.names.index(f"hand_eye.{k}") for k in HAND_EYE]
    return local_error(c.state.T_flange_scanner, r.T_flange_scanner), c.covariance[np.ix_(at, at)]


@pytest.mark.parametrize("measurement", [ARTEFACT_IN_SCANNER, TARGET_IN_BASE])
@pytest.mark.parametrize("kind", ["certified", "target", "sphere", "uncertified"])
def test_the_stated_uncertainty_holds_of_every_kind_of_input(kind, measurement):
    """A short form of benchmarks/accuracy.py hand-eye: over recordings the squared error in stated sigmas is a chi square."""
    nees = []
    for seed in range(8):
        error, covariance = found_and_covariance(recording(np.random.default_rng(seed), kind, measurement=measurement), measurement)
        nees.append(error @ np.linalg.solve(covariance, error) / 6)
    # chi square of 48 degrees of freedom over 48: 0.5 and 1.7 are its limits at 1e-3
    assert 0.5 < np.mean(nees) < 1.7


def test_poses_of_the_flange_calibrate_the_hand_eye_alone(tmp_path):
    r = recording(np.random.default_rng(1), "certified")
    with pytest.raises(CalibrationError, match=r"by the flange and not by joint angles.*--hand-eye-only"):
        mbcacq.calibrate(r.observations)
    assert not options_for(r.observations, mbcacq.CalibrationOptions()).kinematics
    found = mbcacq.calibrate(r.observations, ALONE)
    (tmp_path / "result.json").write_text(found.to_json())
    again = CalibratedCell.from_json(tmp_path / "result.json")
    np.testing.assert_array_equal(again.state.T_flange_scanner, found.state.T_flange_scanner)
    np.testing.assert_array_equal(again.state.chain.flange(r.observations.q), r.observations.cell.robot.chain.flange(r.observations.q))


def test_an_observation_set_of_flange_and_target_poses_comes_back(tmp_path):
    r = recording(np.random.default_rng(2), "target")
    write_observation_set(r.observations, tmp_path / "set")
    again = mbcacq.load_observations(tmp_path / "set")
    for name in ("q", "xyz", "covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(r.observations, name))
    np.testing.assert_allclose(again.rotation, r.observations.rotation, atol=1e-15)
    assert again.cell.robot.of_flange_poses


def test_a_fixed_scanner_is_named_and_a_plain_word_says_it(tmp_path):
    r = recording(np.random.default_rng(3), "certified", measurement=TARGET_IN_BASE)
    wrong = replace(r.observations, cell=replace(r.observations.cell, measurement=ARTEFACT_IN_SCANNER))
    with pytest.raises(CalibrationError, match="fixed scanner: use measurement: target_in_base"):
        mbcacq.calibrate(wrong, ALONE)
    write_observation_set(wrong, tmp_path / "set")
    text = (tmp_path / "set" / "cell.yaml").read_text()
    for word in ("eye_to_hand", "fixed_scanner"):
        (tmp_path / "set" / "cell.yaml").write_text(text.replace("artefact_in_scanner", word))
        found = mbcacq.calibrate(tmp_path / "set", ALONE)
        assert np.abs(local_error(found.state.T_base_station[0], r.T_base_station)[:3]).max() < 0.1
    shown = CliRunner().invoke(calibrate_command, [str(tmp_path / "set"), "--hand-eye-only"]).stdout
    assert "instrument 's' in the base" in shown


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (lambda o: replace(o, q=o.q * [1e-3, 1e-3, 1e-3, 1, 1, 1]), "the places of the flange read as metres, not millimetres"),
        (lambda o: replace(o, q=o.q * [0.1, 0.1, 0.1, 1, 1, 1]), "the places of the flange read as centimetres, not millimetres"),
        (lambda o: replace(o, xyz=0.1 * o.xyz), "the measured points read as centimetres, not millimetres"),
        (lambda o: replace(o, q=in_radians(o.q)), "the orientations of the flange read as radians, not degrees"),
    ],
)
def test_a_wrong_unit_of_flange_or_points_is_refused_by_its_name(wrong, named):
    r = recording(np.random.default_rng(11), "certified")
    with pytest.raises(CalibrationError, match=named):
        mbcacq.calibrate(wrong(r.observations), ALONE)


def in_radians(q):
    """Coordinates of the flange whose angles about z, y, x were written in rad and are read as degrees."""
    T = flange_transforms(q)
    return flange_coordinates(se3.transform(to_matrices(np.radians(to_numbers(T[:, :3, :3], "ZYX")), "ZYX"), T[:, :3, 3]))


def test_one_ball_of_an_artefact_of_several_is_enough_for_the_hand_eye():
    r = recording(np.random.default_rng(5), "certified")
    obs, one = r.observations, r.observations.ball == 2
    only = replace(obs, pose=obs.pose[one], ball=obs.ball[one], xyz=obs.xyz[one])
    found = mbcacq.calibrate(only, ALONE)
    assert np.abs(local_error(found.state.T_flange_scanner, r.T_flange_scanner)[:3]).max() < 0.12


def test_a_known_length_gives_an_artefact_without_certificate_its_scale():
    r = recording(np.random.default_rng(6), "uncertified", noise=0.05)
    artefact = r.observations.cell.artefacts[0]
    length = float(np.linalg.norm(BALLS[0] - BALLS[1]))
    known = replace(artefact, known_length=KnownLength((1, 2), length, 0.001))
    longer = replace(r.observations, xyz=1.002 * r.observations.xyz)  # a scanner whose millimetre is too short
    obs = with_estimated_centres(replace(longer, cell=replace(longer.cell, artefacts=(known,))), "test")
    assert obs.scale == pytest.approx(1 / 1.002, abs=2e-5)
    result = mbcacq.calibrate(obs, ALONE)
    assert np.abs(local_error(result.state.T_flange_scanner, r.T_flange_scanner)[:3]).max() < 0.02
    assert "known length of balls 1 and 2" in result.to_dict()["scale"]
    plain = mbcacq.calibrate(with_estimated_centres(r.observations, "test"), ALONE).to_dict()
    assert plain["scale"].startswith("the instrument's own")
    assert plain["scan_scale"] is None


def test_closed_forms_stand_beside_maximum_likelihood_with_held_out_errors():
    for measurement in (ARTEFACT_IN_SCANNER, TARGET_IN_BASE):
        r = recording(np.random.default_rng(7), "target", measurement=measurement)
        rows = {row.method: row for row in compare(r.observations)}
        ours = rows["hand-eye only"].held_out_mm
        others = [row.held_out_mm for name, row in rows.items() if name.startswith("AX=")]
        assert len(others) == 7
        assert all(ours < 1.02 * other for other in others)


def test_a_weight_of_stated_covariances_is_as_good_as_the_best_pose():
    """Two thirds of the poses a hundred times as noisy as stated for the rest: with their covariances they do no harm."""
    r = recording(np.random.default_rng(8), "target", poses=36)
    obs = r.observations
    bad = np.arange(36) % 3 > 0
    rng = np.random.default_rng(9)
    worse = np.where(bad, 30.0, 0.0)[:, None] * np.array([0.03, 0.03, 0.15, 1e-3, 1e-3, 2e-4]) * rng.normal(size=(36, 6))
    noisy = replace(
        obs,
        xyz=obs.xyz + worse[:, :3],
        rotation=se3.rotation_exp(worse[:, 3:]) @ obs.rotation,
        covariance=obs.covariance * np.where(bad, 901.0, 1.0)[:, None, None],
    )
    found = mbcacq.calibrate(noisy, ALONE)
    assert np.abs(local_error(found.state.T_flange_scanner, r.T_flange_scanner)[:3]).max() < 0.2


def test_the_command_says_what_it_took_the_poses_for(tmp_path):
    r = recording(np.random.default_rng(10), "certified")
    write_observation_set(r.observations, tmp_path / "set")
    done = CliRunner().invoke(calibrate_command, [str(tmp_path / "set"), "--json"])
    content = json.loads(done.stdout)
    assert "by the flange and not by joint angles" in content["scope"]
    assert content["robot"]["flange_poses"] is True


def test_of_poses_of_the_flange_no_effect_of_a_joint_is_asked_for():
    """There are no joint angles: an effect named at a joint would be an invention."""
    found = recording(np.random.default_rng(3), "sphere")
    with pytest.raises(ConfigError, match="no joint angles.*mbcacq compare"):
        mbcacq.diagnose(found.observations)
    assert next_of_flange_poses((Path("poses.csv"),), None)[1] == "mbcacq calibrate poses.csv --hand-eye-only --out result.json"
    assert next_of_flange_poses((Path("poses.csv"),), Path("he.json"))[1] == "mbcacq verify he.json OTHER"
