"""A diagnosis states the cell that it starts from: to the last digit the one that a calibration of the geometry alone has."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
import simulated
from click.testing import CliRunner
from test_result import FOUND

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.several import calibrate_together
from mbcacq.cli import calibrate as calibrate_command
from mbcacq.cli import diagnose as diagnose_command
from mbcacq.diagnosis.output.text import geometry_lines, words
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.schema import diagnosis_schema
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.json_text import fields_as_json
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.observation_set import write_observation_set

HELD = CalibrationOptions(refuse=False, discrepancy=False, random_links=False)


def in_a_result(content):
    """What a diagnosis states of a cell, taken from the content of result.json."""
    noise = {key: value for key, value in content["noise"].items() if key != "check_factor"}
    fit = {key: content["fit"][key] for key in ("poses", "centres", "rms_mm", "chi2", "dof")}
    parameters = [p for p in content["parameters"] if not p["name"].startswith("ball_")]
    calibrated = content["robot"]["calibrated"]
    return {**fit, "noise": noise, "calibrated": calibrated, "T_flange_scanner": content["T_flange_scanner"], "parameters": parameters}


def as_json(content):
    return json.loads(json.dumps(content))


def by_the_commands(folder, tmp_path, *options):
    """What the two commands write of one recording, and what the diagnosis prints. options: of the calibration."""
    written = []
    for module, more in ((calibrate_command, ("--geometry-alone", *options)), (diagnose_command, ())):
        file = tmp_path / "written.json"
        done = CliRunner().invoke(module.command, [str(folder), "--out", str(file), *more], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        written.append(json.loads(file.read_text()))
    return *written, done.output


@pytest.fixture(scope="module")
def observed():
    """A soft A2 and some wrong centres in few poses: geometry alone rejects more than are wrong."""
    return simulated.observe(simulated.plan(stations=4, bars=2, each=6), 8, [("joint_compliance", ("A2",), [5e-6], None)], outliers=0.01)


def test_both_commands_write_one_cell_although_the_search_begins_with_more_centres(observed, tmp_path):
    write_observation_set(observed, tmp_path / "set")
    read = load_observations(tmp_path / "set")
    assert prepare(read).linear.keep.sum() > calibrate(read, HELD).fit.used.sum()

    calibrated, found, printed = by_the_commands(tmp_path / "set", tmp_path, "--even-if-undetermined")

    assert found["geometry_alone"] == [in_a_result(calibrated)]
    assert found["effects"][0]["name"] == "joint_compliance"
    jsonschema.validate(found, diagnosis_schema())
    fit = calibrated["fit"]
    assert f"Geometry alone: {fit['poses']} poses, {fit['centres']} centres; noise " in printed


@pytest.mark.shared_data
def test_both_commands_write_one_cell_of_an_open_recording(shared_data, tmp_path):
    calibrated, found, _ = by_the_commands(shared_data / "example-none", tmp_path)

    assert found["geometry_alone"] == [in_a_result(calibrated)]


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["panda-sockets", "iiwa14-sockets", "ur5-tracker"])
def test_an_open_recording_has_one_cell(shared_data, name):
    recorded = load_observations(shared_data / name)

    (stated,) = prepare(recorded).geometry_alone

    assert as_json(fields_as_json(stated)) == as_json(in_a_result(calibrate(recorded, HELD).to_dict()))


def test_verification_poses_are_not_counted(plan):
    observed = simulated.observe(plan, 42)
    phase = np.where(np.arange(observed.n_poses) < 20, "verification", "position")

    (stated,) = prepare(replace(observed, phase=phase)).geometry_alone

    assert stated.poses == observed.n_poses - 20


def test_recordings_of_one_arm_have_a_cell_each(plan):
    several = [simulated.observe(plan, seed, arm=7) for seed in (1, 2)]

    stated = prepare(several).geometry_alone

    assert [fields_as_json(one) for one in stated] == as_json([in_a_result(c.to_dict()) for c in calibrate_together(several, HELD)])
    assert stated[0].calibrated == stated[1].calibrated
    assert [line.split(":")[0] for line in geometry_lines(stated)] == ["Geometry alone, recording 1", "Geometry alone, recording 2"]


def test_a_measured_orientation_has_a_noise_of_its_own():
    q = np.radians(np.random.default_rng(3).uniform(-60, 60, (60, 6)))
    observed = simulated.observe(simulated.tracked(q), 4)

    (stated,) = prepare(observed).geometry_alone

    assert stated.noise.turn_rad == calibrate(observed, HELD).noise.turn
    assert "orientations" in geometry_lines([stated])[0]


def test_a_diagnosis_without_it_stays_readable(observed):
    (stated,) = prepare(observed).geometry_alone
    found = replace(FOUND, geometry_alone=(stated,))
    content = as_json(found.to_json())
    older = {key: value for key, value in content.items() if key != "geometry_alone"}

    assert Diagnosis.from_json(content) == found
    assert Diagnosis.from_json(older) == FOUND
    assert "Geometry alone" in words(found)
    assert "Geometry alone" not in words(Diagnosis.from_json(older))
