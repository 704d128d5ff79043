"""A change in mid-recording is found at its moment, with its size and the hand-eye before and after it; where nothing changed, none is."""

from dataclasses import replace

import numpy as np
import pytest
from cells import kr10, measure, scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.change import evidence_of_change, kinds_of_change
from mbcacq.estimation.adjustment import adjust_recording
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.step_test import StepTest
from mbcacq.geometry import se3
from mbcacq.workflow.load import load_observations

HAND_EYE_ALONE = CalibrationOptions(kinematics=False)
NOISE = (0.005, 0.005, 0.009)


def cell_of(seed, stations=4, per_station=12):
    return scanner_cell(np.random.default_rng(seed), stations=stations, per_station=per_station, errors=np.zeros((6, 5)))


def remeasured(cell, truth, first, seed=9):
    """The recording with the poses from ``first`` on measured in another state of the cell."""
    other = measure(cell.observations, truth, np.random.default_rng(seed), NOISE, 8e-6)
    later = cell.observations.pose >= first
    return replace(cell.observations, xyz=np.where(later[:, None], other.xyz, cell.observations.xyz))


def slipped(cell, first, mm=0.06):
    turned = cell.truth.T_flange_scanner @ se3.exp(np.array([mm, 0, 0, 0, 0, 0]))
    return remeasured(cell, replace(cell.truth, T_flange_scanner=turned), first), turned


def change_in(obs):
    return evidence_of_change(adjust_recording(obs, HAND_EYE_ALONE)).found


@pytest.mark.parametrize("seed", range(3))
def test_a_scanner_that_slipped_by_a_few_noises_is_found_with_the_hand_eye_before_and_after(seed):
    cell = cell_of(seed)
    obs, after = slipped(cell, 19)
    found = calibrate(obs, HAND_EYE_ALONE).to_dict()
    change = found["change"]
    assert change["kind"] in ("mount", "scanner")
    assert abs(change["nth"] - 20) <= 1
    std = np.array(change["hand_eye_std"])
    for said, true in ((change["hand_eye_before"], cell.truth.T_flange_scanner), (change["hand_eye_after"], after)):
        assert np.all(np.abs((np.linalg.inv(np.array(said)) @ true)[:3, 3]) < 4 * std[:3] + 0.004)
    assert "mount slipped between pose 18 and pose 19" in found["warnings"][0] or abs(change["before"] - 18) <= 1


@pytest.mark.parametrize("seed", range(8))
def test_of_an_undisturbed_recording_nothing_is_said(seed):
    assert change_in(cell_of(100 + seed).observations) is None


def largest_z(found, true):
    """The six numbers of the hand-eye, in stated standard deviations, against the nearest of the true transforms."""
    std = np.sqrt(np.diag(found.covariance)[[found.names.index(f"hand_eye.{c}") for c in ("x", "y", "z", "rx", "ry", "rz")]])
    off = [np.linalg.inv(found.state.T_flange_scanner) @ T for T in true]
    return min(np.abs(np.concatenate([D[:3, 3], se3.rotation_log(D[:3, :3])]) / std).max() for D in off)


@pytest.mark.parametrize("seed", range(6))
def test_a_slip_about_as_large_as_the_noise_is_named_or_in_the_stated_uncertainty(seed):
    """Without the average over changes five of these six are beyond three standard deviations."""
    cell = cell_of(seed)
    obs, after = slipped(cell, 24, mm=0.008)
    found = calibrate(obs, HAND_EYE_ALONE)
    assert largest_z(found, (cell.truth.T_flange_scanner, after)) < 3
    assert ("change" in found.extra) <= (found.extra.get("change_probability", 0) > 0.9)


def test_a_ball_that_moved_so_far_that_its_centres_are_rejected_is_named():
    cell = cell_of(6)
    balls = cell.truth.balls.copy()
    balls[4] += [0.4, 0, 0]
    obs = remeasured(cell, replace(cell.truth, balls=balls), 30)
    fitted = adjust_recording(obs, HAND_EYE_ALONE)
    assert np.sum(fitted.weights.centre == 0) > 10
    change = evidence_of_change(fitted).found
    assert (change.kind, change.where, change.nth) == ("ball", "5", 31)


@pytest.mark.parametrize("first", [40, 46])
def test_an_accident_so_large_that_the_poses_after_it_are_rejected_is_named(first):
    cell = cell_of(6)
    after = cell.observations.pose >= first
    obs = replace(cell.observations, xyz=np.where(after[:, None], 1.015, 1.0) * cell.observations.xyz)
    assert np.all(adjust_recording(obs, HAND_EYE_ALONE).weights.pose[first:] == 0)
    assert "scale of the scanner's coordinates changed between pose" in calibrate(obs, HAND_EYE_ALONE).to_dict()["warnings"][0]


@pytest.mark.parametrize("settling", [0.15, 2.0])
def test_a_scanner_that_warms_up_did_not_slip(settling):
    """Without a drift beside the step both recordings name the mount."""
    cell = cell_of(20)
    warm = 1 - np.exp(-cell.observations.pose / (settling * cell.observations.n_poses))
    assert change_in(replace(cell.observations, xyz=cell.observations.xyz + warm[:, None] * np.array([0.03, -0.02, 0.04]))) is None


def test_two_gross_poses_at_the_start_of_a_station_are_no_step():
    cell = cell_of(6)
    gross = np.isin(cell.observations.pose, [24, 25])
    assert change_in(replace(cell.observations, xyz=cell.observations.xyz + 1.5 * gross[:, None])) is None


def test_an_encoder_that_jumped_is_named_by_its_axis():
    cell = cell_of(5)
    errors = np.zeros((6, 5))
    errors[2, 0] = 2e-4
    change = change_in(remeasured(cell, replace(cell.truth, chain=kr10().with_errors(errors)), 30))
    assert (change.kind, change.where, change.nth) == ("joint", "3", 31)
    assert change.value[0] == pytest.approx(2e-4, abs=4 * change.std[0])


def test_a_ball_that_moved_is_named():
    cell = cell_of(6)
    balls = cell.truth.balls.copy()
    balls[4] += [0.03, 0, 0]
    change = change_in(remeasured(cell, replace(cell.truth, balls=balls), 21))
    assert (change.kind, change.where, change.nth) == ("ball", "5", 22)
    assert np.abs(np.array(change.value) - [0.03, 0, 0]).max() < 0.008


def test_neither_the_base_frame_nor_the_numbers_of_stations_matter():
    cell = cell_of(7)
    obs, _ = slipped(cell, 19)
    same = change_in(obs)
    turned = replace(obs, station=3 - obs.station, cell=replace(obs.cell, stations=obs.cell.stations[::-1]))
    other = change_in(turned)
    assert (other.kind, other.nth, other.station) == (same.kind, same.nth, same.station)
    assert other.log_e == pytest.approx(same.log_e, abs=0.5)


def test_the_score_is_that_of_a_refit():
    """Chi square with each column of a step added to all other columns and solved as one dense problem."""
    fitted = adjust_recording(cell_of(8, 2, 8).observations, HAND_EYE_ALONE)
    at = fitted.solution.evaluated()
    test, kind = StepTest(at), next(kinds_of_change(at))
    gain = test.of(kind.columns).gain
    rows, g = at.lineariser.rows, at.normal.size
    stations = np.concatenate([at.X[..., g : g + 6] * (rows.run == s)[:, None, None] for s in range(2)], axis=2)
    prior = np.concatenate([np.diag(1 / at.prior.sigma), np.zeros((g, 12))], axis=1)
    A = np.concatenate([np.concatenate([at.X[..., :g], stations], axis=2).reshape(-1, g + 12), prior])
    b = np.concatenate([at.X[..., -1].reshape(-1), -at.prior.offset / at.prior.sigma])

    def left(columns):
        columns = columns / np.linalg.norm(columns, axis=0)
        return np.sum((b - columns @ np.linalg.lstsq(columns, b, rcond=1e-13)[0]) ** 2)

    for t in (5, 8, 11):
        step = at.whitening(rows.pad(kind.columns * (at.lineariser.obs.pose >= t)[:, None, None])).reshape(-1, 6)
        with_step = np.concatenate([A, np.concatenate([step, np.zeros((g, 6))])], axis=1)
        assert gain[t] == pytest.approx(left(A) - left(with_step), rel=1e-4)


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "first", "alone"),
    [
        ("hand-scanner-slip", 21, True),
        ("hand-scanner-turn", 43, True),
        ("hand-scan-step-z", 33, True),
        ("whole-mount-rescrew", None, False),
    ],
)
def test_strikes_that_somebody_else_made_are_named_with_their_pose(shared_data, name, first, alone):
    folder = shared_data.parent / "cases" / "strikes" / name
    if not folder.exists():
        pytest.skip(f"{folder} is missing")
    found = calibrate(load_observations(folder), HAND_EYE_ALONE if alone else None)
    change = found.extra["change"]
    assert change["kind"] in ("mount", "scanner")
    assert first is None or (abs(change["before"] - first) <= 1 and abs(change["after"] - first) <= 1)
    assert found.extra["warnings"][0].startswith("Something changed while the recording was made: the scanner's mount slipped")
