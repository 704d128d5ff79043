"""Recordings that cannot determine a cell, through every method: a refusal that says what is missing, or no figure; never a wrong number."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from cells import measure, scanner_cell, tracker_cell
from click.testing import CliRunner
from scipy.optimize import least_squares

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.compare_methods import COMPARED_METHODS, compare
from mbcacq.errors import CalibrationError
from mbcacq.estimation import forward_model
from mbcacq.estimation.initial_guess import start
from mbcacq.estimation.options import CalibrationOptions

NOISE = (0.005, 0.005, 0.009)
AXXB = [name for name in COMPARED_METHODS if name.startswith("AX=")]
PAPER = [name for name in COMPARED_METHODS if name.startswith("paper")]
OURS = ["geometry alone", "maximum likelihood"]
JOINT = [*PAPER, "distances only", *OURS]
pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(21), stations=4, per_station=8, preliminary=True)


def fresh(cell, q, where=None):
    obs = replace(cell.observations, q=q)
    return measure(obs if where is None else obs.select(where), cell.truth, np.random.default_rng(1), NOISE, 8e-6)


def one_orientation(_):
    return scanner_cell(np.random.default_rng(3), stations=4, tilt_deg=0.01).observations


def one_station(cell):
    return cell.observations.select(cell.observations.station == 0)


def two_balls(cell):
    obs = cell.observations
    two = obs.ball < 2
    return replace(obs, pose=obs.pose[two], ball=obs.ball[two], xyz=obs.xyz[two])


def turns_about_one_axis(cell):
    obs = cell.observations
    first = np.array([np.flatnonzero(obs.station == s)[0] for s in obs.station])
    q = obs.q[first].copy()
    q[:, 5] += np.linspace(-1, 1, len(q))
    return fresh(cell, q, obs.phase == "position")


def one_pose(cell):
    return cell.observations.select(np.arange(cell.observations.n_poses) == 3)


def identical_joints(cell):
    obs = cell.observations
    first = np.array([np.flatnonzero(obs.station == s)[0] for s in obs.station])
    return fresh(cell, obs.q[first], obs.phase == "position")


def no_translations(cell):
    q = cell.observations.q.copy()
    still = np.flatnonzero(cell.observations.phase == "translation")
    q[still] = q[still[0]]
    return fresh(cell, q)


def balls_on_one_line(cell):
    line = np.linspace(-40, 40, 8)[:, None] * np.array([1.0, 0.3, -0.2])
    obs = cell.observations
    flat = replace(obs, cell=replace(obs.cell, artefacts=(replace(obs.cell.artefacts[0], centres=line),)))
    return measure(flat, replace(cell.truth, balls=line), np.random.default_rng(1), NOISE, 8e-6)


UNDETERMINED = {  # recording -> which methods must refuse it, with what
    one_orientation: {
        **dict.fromkeys(AXXB, "about one axis only"),
        "hand-eye only": "same orientation",
        **dict.fromkeys(PAPER, "do not determine"),
        "distances only": "same orientation",
        **dict.fromkeys(OURS, "same orientation"),
    },
    one_station: dict.fromkeys(JOINT, "all poses are at one station"),
    two_balls: {
        **dict.fromkeys(AXXB, "three balls each"),
        **dict.fromkeys(PAPER, "four balls"),
        **dict.fromkeys(OURS, "three balls of the artefact"),
    },
    turns_about_one_axis: {
        **dict.fromkeys(AXXB, "about one axis only"),
        "hand-eye only": "hand_eye",
        "distances only": "hand_eye",
        **dict.fromkeys(PAPER, "first hand-eye transform"),
        **dict.fromkeys(OURS, "hand_eye"),
    },
    no_translations: dict.fromkeys(PAPER, "do not span a plane"),
    balls_on_one_line: {**dict.fromkeys(AXXB, "not all on one line"), **dict.fromkeys(PAPER, "not on one line")},
}


@pytest.mark.parametrize("recording", UNDETERMINED, ids=lambda f: f.__name__)
def test_every_method_refuses_what_it_cannot_determine(cell, recording):
    obs = recording(cell)
    rows = {row.method: row for row in compare(obs, held_out=False)}
    assert list(rows) == list(COMPARED_METHODS)
    for name, row in rows.items():
        reason = UNDETERMINED[recording].get(name)
        if reason is None:
            assert row.fit_mm is not None, f"{name}: {row.why}"
        else:
            assert reason in row.why, name
            assert (row.fit_mm, row.bar_mean_mm, row.bar_max_mm, row.held_out_mm) == (None, None, None, None)


@pytest.mark.parametrize("recording", [one_pose, identical_joints], ids=lambda f: f.__name__)
def test_one_posture_a_station_is_nothing_to_compare(cell, recording):
    obs = recording(cell)
    with pytest.raises(CalibrationError, match="one posture of the arm only"):
        compare(obs)
    with pytest.raises(CalibrationError, match="same orientation"):
        calibrate(obs)
    for pairs in ("one", "four", "all"):
        with pytest.raises(CalibrationError, match="first hand-eye transform|one axis"):
            calibrate(obs, CalibrationOptions(method="paper", pairs=pairs))


def test_poses_of_one_orientation_are_calibrated_where_the_hand_eye_translation_is_held_or_nothing_is_refused(cell):
    obs = one_orientation(cell)
    with pytest.raises(CalibrationError, match="same orientation"):
        calibrate(obs)
    held = tuple(f"hand_eye.{c}" for c in ("x", "y", "z", "rx", "ry", "rz"))
    for options in (CalibrationOptions(hold=held), CalibrationOptions(refuse=False)):
        assert calibrate(obs, replace(options, kinematics=False)).fit.rms_mm < 0.5


@pytest.mark.parametrize("recording", [no_translations, balls_on_one_line], ids=lambda f: f.__name__)
def test_what_maximum_likelihood_does_determine_is_right(cell, recording):
    """Without translations, or with balls on one line, orientations and stations still tell everything: normalised errors say so."""
    found = calibrate(recording(cell))
    off = (found.errors - cell.errors).reshape(-1)[found.layout.blocks[0].free]
    n = len(off)
    assert off @ np.linalg.solve(found.covariance[:n, :n], off) < n + 4 * np.sqrt(2 * n)


def test_a_figure_that_cannot_be_held_out_says_why(cell):
    """Two stations: without one, nothing is left for the joint methods; the fit itself stands."""
    obs = cell.observations
    few = obs.select(np.isin(obs.station, [0, 1]) & (obs.phase == "position"))
    row = compare(few.select(np.arange(few.n_poses) % 2 == 0), ["hand-eye only"])[0]
    assert row.why == ""
    assert (row.held_out_mm is None) == (row.why_not_held_out != "")


def test_the_command_ends_with_its_own_exit_code(cell, tmp_path):
    from mbcacq.cli.app import app
    from mbcacq.recording.datasets.observation_set import write_observation_set

    write_observation_set(one_pose(cell), tmp_path / "one")
    outcome = CliRunner().invoke(app, ["compare", str(tmp_path / "one")])
    assert outcome.exit_code == 7, outcome.output
    assert "one posture" in outcome.stderr
    write_observation_set(one_station(cell), tmp_path / "station")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        outcome = CliRunner().invoke(app, ["compare", "--json", "--no-held-out", str(tmp_path / "station")])
    assert outcome.exit_code == 0, outcome.output
    rows = {r["method"]: r for r in json.loads(outcome.stdout)["rows"]}
    assert rows["maximum likelihood"]["fit_mm"] is None
    assert "one station" in rows["maximum likelihood"]["why"]
    assert CliRunner().invoke(app, ["calibrate", str(tmp_path / "station")]).exit_code == 7


def test_a_grid_in_one_orientation_puts_the_tracker_where_it_stands():
    """The place of the target on the flange stays open, so the tracker is off by its distance from the flange at most: 97 mm, not by what
    rounding of joint angles to 1e-6 deg makes of it."""
    made = tracker_cell(np.random.default_rng(0), poses=20, orientation=True)
    chain, first = made.observations.cell.robot.chain, np.array([0.1, -1.2, 1.5, 0.2, 0.8, 0.3])
    T = chain.flange(first[None])[0]
    corners = T[:3, 3] + 250.0 * np.random.default_rng(1).uniform(-1, 1, (20, 3))

    def off(q, place):
        at = chain.flange(q[None])[0]
        return np.concatenate([at[:3, 3] - place, 500.0 * (at[:3, :3] - T[:3, :3]).ravel()])

    q = np.array([least_squares(off, first, args=(place,), xtol=1e-15, ftol=1e-15, gtol=1e-15).x for place in corners])
    q = np.radians(np.round(np.degrees(q), 6))
    state = replace(made.truth, chain=chain)
    blank = replace(made.observations, q=q)
    seen = forward_model.predict(blank, state)
    noisy = seen.xyz + np.random.default_rng(2).normal(0, 0.02, (20, 3))
    begun = start(replace(blank, xyz=noisy, rotation=seen.rotation))
    away = np.linalg.norm(begun.T_base_station[0, :3, 3] - state.T_base_station[0, :3, 3])
    assert away < np.linalg.norm([30.0, -20, 90]) + 1.0
    assert np.abs(begun.T_base_station[0, :3, :3] - state.T_base_station[0, :3, :3]).max() < 5e-4
