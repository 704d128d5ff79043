"""plan check, run and calibrate say the same of one plan: the arm at several stations, the hand-eye transform alone at one."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import scanner_cell
from click.testing import CliRunner

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.sufficiency import HAND_EYE_ALONE, options_for
from mbcacq.cli.app import app
from mbcacq.design.planned_scope import planned_scope, scope_sentence
from mbcacq.design.simulated_observations import planned_noise, planned_observations, simulated_recording
from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.plan import expand, load
from mbcacq.recording.datasets.observation_set import write_observation_set

PLANS = Path(__file__).parents[2] / "plans"


def plan_of(folder, change=("", "")):
    text = (PLANS / "quick.yaml").read_text().replace(*change, 1).replace("robots/", f"{PLANS}/robots/")
    path = folder / "plan.yaml"
    path.write_text(text.replace("artefacts/", f"{PLANS}/artefacts/"))
    return load(path)


def verdicts(loaded, folder):
    """The verdict of plan check, of a run at its begin, of calibrate at the recording: printed or raised."""
    poses = expand(loaded)
    recorded = simulated_recording(loaded, planned_observations(loaded, poses), planned_noise(loaded, poses), np.random.default_rng(1))
    write_observation_set(recorded, folder / "set")
    checked = CliRunner().invoke(app, ["plan", "check", "--json", str(loaded.path)])
    calibrated = CliRunner().invoke(app, ["calibrate", str(folder / "set"), "--json"])
    return json.loads(checked.stdout), scope_sentence(loaded, poses), calibrated


def test_one_station_without_the_phase_position_gives_the_hand_eye_alone(tmp_path):
    checked, at_begin, calibrated = verdicts(plan_of(tmp_path), tmp_path)
    assert HAND_EYE_ALONE in [f["sentence"] for f in checked["findings"]]
    assert (checked["prospect"]["determined"], checked["prospect"]["parameters"]) == (6, 6)
    assert checked["prospect"]["expected_workspace_mm"] is None  # the arm's own errors are not known
    assert at_begin == HAND_EYE_ALONE
    found = json.loads(calibrated.stdout)
    assert found["scope"] == HAND_EYE_ALONE
    assert {p["name"].split(".")[0] for p in found["parameters"] if p["status"] == "free"} == {"hand_eye"}
    shown = CliRunner().invoke(app, ["calibrate", str(tmp_path / "set")]).stdout
    assert f"Scope: {HAND_EYE_ALONE}" in shown
    assert "MD-H errors" not in shown
    assert "Held: the arm's 30 parameters" in shown


def test_one_station_with_the_phase_position_is_refused_by_all(tmp_path):
    checked, at_begin, calibrated = verdicts(plan_of(tmp_path, ("phase: orientation", "phase: position")), tmp_path)
    assert calibrated.exit_code == 7
    refusal = calibrated.stderr.strip().removeprefix("mbcacq: ")
    assert "all poses are at one station" in refusal
    assert at_begin == f"a calibration will refuse these poses: {refusal}"
    assert at_begin in [f["sentence"] for f in checked["findings"] if f["code"] == "undetermined"]
    assert checked["prospect"] is None


def test_several_stations_leave_nothing_to_say():
    loaded = load(PLANS / "kuka.yaml")
    poses = expand(loaded)
    assert scope_sentence(loaded, poses) == ""
    assert planned_scope(planned_observations(loaded, poses)) == CalibrationOptions()


def test_options_that_decide_the_scope_already_stay():
    obs = scanner_cell(np.random.default_rng(2), stations=1).observations
    single = replace(obs, phase=np.full(obs.n_poses, "orientation"))
    assert not options_for(single, CalibrationOptions()).kinematics
    for options in (CalibrationOptions(method="paper"), CalibrationOptions(refuse=False), CalibrationOptions(kinematics=False)):
        assert options_for(single, options) == options
    assert options_for(replace(obs, phase=None), CalibrationOptions()) == CalibrationOptions()
    with pytest.raises(CalibrationError, match="all poses are at one station"):
        calibrate(single)
