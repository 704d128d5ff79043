"""Each stage of the published method on its own, against a cell of known truth; and all of them together."""

from dataclasses import replace

import numpy as np
import pytest
from cells import HAND_EYE, MBC, measure, scanner_cell, tracker_cell
from hand_eye_data import local_error, recording

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.calibration.staged import angle_adjustment, distance_constraint, method, stages
from mbcacq.calibration.staged.pair_distances import scanner_noise
from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(31), stations=8, per_station=8, bars=4, preliminary=True)


@pytest.fixture(scope="module")
def exact():
    """No noise and a perfect arm."""
    return scanner_cell(
        np.random.default_rng(32), stations=2, per_station=4, errors=np.zeros((6, 5)), noise=(0, 0, 0), joint_rad=0, preliminary=True
    )


def test_angles_and_their_derivatives():
    corners = angle_adjustment.triples(4)
    assert len(corners) == 12
    right = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]])
    value, B = angle_adjustment.angles(right, corners)
    assert np.degrees(value[0][(corners == [0, 1, 2]).all(axis=1)]) == pytest.approx(90)
    assert np.degrees(value[0][(corners == [1, 0, 2]).all(axis=1)]) == pytest.approx(45)
    rng = np.random.default_rng(1)
    points = rng.normal(size=(1, 4, 3))
    _, B = angle_adjustment.angles(points, corners)
    for j in range(12):
        step = np.zeros(12)
        step[j] = 1e-6
        difference = (
            angle_adjustment.angles(points + step.reshape(4, 3), corners)[0]
            - angle_adjustment.angles(points - step.reshape(4, 3), corners)[0]
        )
        np.testing.assert_allclose(B[0, :, j], difference[0] / 2e-6, atol=1e-7)


def test_angles_leave_seven_directions_undetermined():
    _, B = angle_adjustment.angles(MBC[None], angle_adjustment.triples(8))
    assert np.linalg.matrix_rank(B[0], tol=1e-9) == 24 - 7


def test_adjustment_restores_the_shape_but_not_the_scale():
    rng = np.random.default_rng(2)
    T = se3.exp(rng.normal(size=(20, 6)) * np.array([50, 50, 50, 0.5, 0.5, 0.5]))
    true = 1.002 * se3.apply(T[:, None], MBC[None])
    measured = true + rng.normal(size=true.shape) * 0.05
    corrected, curve, _ = angle_adjustment.adjust(measured, MBC)

    def shape(points):
        d = np.linalg.norm(points[:, :, None] - points[:, None], axis=3)
        return d, np.linalg.norm(MBC[:, None] - MBC, axis=2)

    before, certified = shape(measured)
    after, _ = shape(corrected)
    upper = np.triu_indices(8, 1)
    scaled = certified[upper] * 1.002
    assert np.std(after[:, *upper] / scaled - 1) < 0.5 * np.std(before[:, *upper] / scaled - 1)
    assert np.mean(after[:, *upper] / certified[upper]) == pytest.approx(1.002, abs=3e-4)
    assert 0 < curve.corner < len(curve.ridge) - 1
    assert np.all(np.diff(curve.misfit) >= -1e-12)
    assert np.all(np.diff(curve.size) <= 1e-12)


def test_l_curve_can_be_drawn(tmp_path):
    _, curve, _ = angle_adjustment.adjust(MBC[None] + np.random.default_rng(3).normal(size=(4, 8, 3)) * 0.01, MBC)
    curve.plot(tmp_path / "curve.html")
    assert "ridge parameter" in (tmp_path / "curve.html").read_text()


def test_hand_eye_of_a_perfect_arm_is_exact(exact):
    obs = exact.observations
    X, stages = method.preliminary(obs)
    np.testing.assert_allclose(X, exact.truth.T_flange_scanner, atol=1e-7)
    assert stages[1]["rms_virtual_point_after_mm"] < 1e-6 < stages[1]["rms_virtual_point_before_mm"]


def test_hand_eye_with_noise_is_near_the_truth(cell):
    X, _ = method.preliminary(cell.observations)
    off = se3.inverse(cell.truth.T_flange_scanner) @ X
    assert np.linalg.norm(off[:3, 3]) < 3.0
    assert np.degrees(np.linalg.norm(se3.rotation_log(off[:3, :3]))) < 0.5


def test_parallel_translations_and_turns_about_one_axis_are_refused(exact):
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 0, 3] = np.arange(6) * 30.0
    with pytest.raises(CalibrationError, match="do not span a plane"):
        stages.rotation_from_translations(T, -T[:, :3, 3])
    turns = se3.exp(np.linspace(0, 1, 6)[:, None] * np.array([0, 0, 0, 0, 0, 1.0]))
    with pytest.raises(CalibrationError, match="one axis only"):
        stages.translation_from_orientations(turns, np.zeros((6, 3)), np.eye(3))


def test_distances_of_one_scan_are_left_out():
    pose, station, ball = np.repeat([0, 1, 2], 2), np.repeat([0, 0, 1], 2), np.tile([0, 1], 3)
    found = distance_constraint.pairs(pose, station, ball, MBC)
    assert {(a, b) for a, b in zip(found.a, found.b, strict=True)} == {(0, 3), (1, 2)}
    np.testing.assert_allclose(found.certified, np.linalg.norm(MBC[0] - MBC[1]))


def test_distance_constraint_identifies_arm_and_hand_eye_without_noise():
    cell = scanner_cell(np.random.default_rng(33), stations=8, per_station=6, noise=(0, 0, 0), joint_rad=0)
    obs = cell.observations
    free = np.concatenate([b.free for b in method.published_layout(obs, CalibrationOptions()).blocks[:2]])
    free &= ~np.isin(np.arange(36), [0, 1, 25, 26, 27, 28, 29])  # theta_1, d_1 and the last link, so that the answer is unique
    at = distance_constraint.pairs(obs.pose, obs.station[obs.pose], obs.ball, obs.cell.ball_centres)
    found = distance_constraint.identify(obs.cell.robot.chain, HAND_EYE, obs, at, free)
    assert found.rms_after < 1e-3 < found.rms_before
    np.testing.assert_allclose(found.chain.rows - obs.cell.robot.chain.rows, cell.errors, atol=0.02)


def test_whole_method_improves_the_bar_and_maximum_likelihood_improves_it_more(cell):
    obs = cell.observations
    published, ours = calibrate(obs, CalibrationOptions(method="paper", pairs="four")), calibrate(obs)
    theirs = verify(obs, published).to_dict()
    assert theirs["after"]["mean_mm"] < theirs["before"]["mean_mm"]
    assert verify(obs, ours).to_dict()["after"]["mean_mm"] < 0.5 * theirs["after"]["mean_mm"]
    stage = published.to_dict()["stages"][-1]
    assert stage["rms_distance_after_mm"] < 0.5 * stage["rms_distance_before_mm"]
    names = [s["stage"] for s in published.to_dict()["stages"]]
    assert [n.split(" (")[0] for n in names] == [
        "angle adjustment",
        "hand-eye rotation from translations",
        "hand-eye translation from orientations",
        "distance constraint",
    ]
    assert "d_2" in published.layout.held
    assert "theta_1" not in published.layout.held


def test_one_pair_of_balls_is_what_is_printed(cell):
    """64 poses at eight places: 8 x 8 x 7 / 2 pairs of poses, each with ball a in one and b in the other, both ways: 448 distances of one length."""
    found = {how: calibrate(cell.observations, CalibrationOptions(method="paper", pairs=how)) for how in ("one", "four", "all")}
    assert [c.extra["stages"][-1]["distances"] for c in found.values()] == [448, 6 * 448, 28 * 448]
    obs = cell.observations.select(cell.observations.phase == "position")
    at = method.constraint(obs, "one")
    four = method.constraint(method.several_balls(obs, "four"), "one")
    assert np.ptp(at.certified) < 1e-9
    assert at.certified[0] == pytest.approx(max(np.linalg.norm(a - b) for a in MBC for b in MBC))
    assert four.certified[0] <= at.certified[0]


@pytest.mark.parametrize(("how", "draws"), [("one", 60), ("four", 60), ("all", 30)])
def test_stated_uncertainty_is_the_scatter_of_repetitions(how, draws):
    """Nearly centred artefact (3 mm): distances share centres, scans and joints. The bars' errors are nearly one
    number a draw, so that the rms of error over sigma is 1 within 3 / sqrt(2 draws)."""
    rng = np.random.default_rng(44)
    cell = scanner_cell(rng, stations=8, per_station=6, bars=4, preliminary=True, tilt_deg=25)
    ends = cell.observations.select(cell.observations.phase == "verification")
    used = cell.observations.select(cell.observations.phase != "verification")
    exact = measure(ends, cell.truth, rng, (0, 0, 0), 0)
    ratio = []
    for _ in range(draws):
        found = calibrate(
            measure(used, cell.truth, rng, (0.005, 0.005, 0.009), 8e-6), CalibrationOptions(method="paper", pairs=how, refuse=False)
        )
        places = verify(exact, found.state).places
        a, b = (
            np.array([np.flatnonzero((exact.station[exact.pose] == s) & (exact.ball == ball))[0] for s in range(8, 12)]) for ball in (8, 9)
        )
        sigma = found.distance_uncertainty(exact.q[exact.pose[a]], exact.xyz[a], exact.q[exact.pose[b]], exact.xyz[b])
        ratio.append(np.array([p.after_mm for p in places]) / sigma)
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1, abs=3 / np.sqrt(2 * draws))


def test_scanner_noise_is_read_off_the_shape_of_the_scans(cell):
    np.testing.assert_allclose(scanner_noise(cell.observations), [0.005, 0.005, 0.009], rtol=0.05)
    noise = calibrate(cell.observations, CalibrationOptions(method="paper", pairs="all")).noise
    np.testing.assert_allclose(noise.joint, 8e-6, rtol=0.4)


def test_refusals(cell):
    with pytest.raises(CalibrationError, match="scanner on the flange"):
        calibrate(tracker_cell(np.random.default_rng(1)).observations, CalibrationOptions(method="paper"))
    obs = cell.observations
    two = obs.ball < 2
    with pytest.raises(CalibrationError, match="needs four balls"):
        calibrate(replace(obs, pose=obs.pose[two], ball=obs.ball[two], xyz=obs.xyz[two]), CalibrationOptions(method="paper"))


def test_the_command_and_the_function_read_the_paper_alike():
    from click.testing import CliRunner

    from mbcacq.cli.app import app

    shown = " ".join(CliRunner().invoke(app, ["calibrate", "--help"]).stdout.split())
    fields = CalibrationOptions()
    pairs = shown.partition("--pairs")[2].partition("[default: ")[2]
    noise = shown.partition("--noise")[2].partition("[default: ")[2]
    assert pairs.startswith(f"{fields.pairs}]")
    assert noise.startswith(f"{fields.noise}]")


def test_the_hand_eye_transform_alone_is_found_stage_by_stage_from_poses_of_the_flange():
    made = recording(np.random.default_rng(4), "certified", noise=0.2)
    both = [calibrate(made.observations, CalibrationOptions(method=m, kinematics=False)) for m in ("paper", "ml")]
    off = [np.abs(local_error(found.state.T_flange_scanner, made.T_flange_scanner)) for found in both]
    assert off[0][:3].max() < 0.1
    assert off[0][3:].max() < 5e-4
    assert [stage["stage"].split(" (")[0] for stage in both[0].extra["stages"]][-1] == "distance constraint"
    assert not any(name.startswith(("theta", "a_", "d_", "alpha")) for name in both[0].layout.names)
