"""The JSON Schema of a diagnosis: what the program writes fits it, what another version wrote stays readable."""

from __future__ import annotations

import json

import jsonschema
import numpy as np
import pytest
import simulated
from click.testing import CliRunner
from test_result import FOUND

from mbcacq.cli.diagnosis_schema import command
from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.output.effects_table import classes
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.schema import diagnosis_schema
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.workflow.diagnose_recordings import provenance
from mbcacq.workflow.diagnosis_result import DiagnosisResult
from mbcacq.workflow.diagnosis_schema import generated_schema


@pytest.fixture(scope="module")
def content(plan, tmp_path_factory):
    from dataclasses import replace

    from mbcacq.recording.datasets.observation_set import write_observation_set

    folder = tmp_path_factory.mktemp("set")
    write_observation_set(plan, folder)
    here = Covariates(plan)
    groups = [unmodelled.group(here, at, on) for at, on in (("A2", "q2"), ("base", "gravity_torque_2"), ("link3", "q3"))]
    model = EffectModel(plan.cell.robot, tuple(groups), LearntRecording.of(plan))
    found = DiagnosisResult(poses=replace(FOUND, model=model), provenance=provenance(folder, (), {"workers": 1}))
    return json.loads(found.to_json())


def test_the_schema_is_one_and_the_command_prints_it():
    jsonschema.Draft202012Validator.check_schema(diagnosis_schema())
    assert json.loads(CliRunner().invoke(command).output) == diagnosis_schema()


def test_the_schema_follows_from_the_types():
    assert diagnosis_schema() == generated_schema(), "write it anew: PYTHONPATH=. python docs/_make/reference.py"


def test_what_is_written_fits_the_schema(content):
    jsonschema.validate(content, diagnosis_schema())


def test_files_of_the_recording_are_named_with_their_hash(content):
    files = {entry["file"].rsplit("/", 1)[-1]: entry for entry in content["provenance"]["files"]}
    assert {"cell.yaml", "poses.csv", "centres.csv"} <= set(files)
    assert all(len(entry["sha256"]) == 64 for entry in files.values())


@pytest.mark.parametrize("key", ["model", "recordings", "provenance", "effects"])
def test_a_diagnosis_without_a_promised_key_does_not_fit(content, key):
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({k: v for k, v in content.items() if k != key}, diagnosis_schema())


def test_the_model_that_was_written_displaces_as_before(plan, content):
    again = DiagnosisResult.from_json(json.dumps(content))
    model = again.model
    assert model is not None
    changed = model.with_coefficients([np.full(t.k, 1e-4) for t in model.terms], [np.zeros(t.k) for t in model.terms])
    written = EffectModel.from_dict(json.loads(json.dumps(changed.to_dict())))
    moved, same = changed.displacements(plan), written.displacements(plan)
    np.testing.assert_array_equal(moved.joint, same.joint)
    np.testing.assert_array_equal(moved.frame, same.frame)


def test_version_1_stays_readable():
    old = FOUND.to_json()
    for key in ("model",):
        old.pop(key)
    for effect in old["effects"]:
        for key in ("p_local", "p_corrected", "log_bayes_factor", "equivalent"):
            effect.pop(key)
    for entry in old["mismatch"]:
        entry.pop("equivalent")
    assert Diagnosis.from_json(old | {"format": "mbcacq-diagnosis/1"}) == FOUND


def test_version_2_stays_readable():
    assert Diagnosis.from_json(FOUND.to_json() | {"format": "mbcacq-diagnosis/2"}) == FOUND


def test_with_one_station_the_base_is_the_station(plan):
    assert classes(plan, ()) == []
    one = plan.select(plan.station == 0)
    name = plan.cell.stations[0].id
    assert classes(one, ()) == [("base", f"station{name}")]
    pair = NotSeparable(("joint_compliance:A2", "joint_compliance:A3"), 0.99)
    assert ("A2", "A3") in classes(plan, [pair])
    # Two effects that do together what one does elsewhere are at no one place.
    several = NotSeparable(("unknown:link2 and unknown:link5", "unknown:base"), 0.99, 0.5)
    assert classes(plan, [several]) == []


def test_a_simulated_recording_of_another_place_is_not_the_one_learnt_from(plan):
    learnt = LearntRecording.of(plan)
    assert learnt.is_of(plan)
    assert learnt.is_of(plan.select(np.arange(plan.n_poses) % 2 == 0))
    assert not learnt.is_of(simulated.replace(plan, q=plan.q + 1e-3))
