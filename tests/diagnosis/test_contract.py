"""The JSON is what other programs were promised."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbcacq.cli.diagnose import command
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.output.text import words
from mbcacq.recording import load_observations

DATA = Path(__file__).parents[3] / "shared" / "data"
VERDICTS = {"none", "explained", "partly_explained", "unexplained", "cannot_tell"}


def check_contract(d: dict) -> None:
    assert d["format"] == "mbcacq-diagnosis/3"
    assert d["verdict"] in VERDICTS
    shares = [m["share"] for m in d["mismatch"]]
    assert shares == sorted(shares, reverse=True)
    for m in d["mismatch"]:
        assert isinstance(m["at"], str)
        assert isinstance(m["depends_on"], str)
        assert 0 <= m["p_value"] <= 1
    for e in d["effects"]:
        assert isinstance(e["name"], str)
        assert e["where"]
        assert all(isinstance(w, str) for w in e["where"])
        assert 0 <= e["p_value"] <= 1
        assert 0 <= e["held_out_gain"] <= 1
        for parameter in e["parameters"].values():
            assert set(parameter) == {"value", "std"}
        for a in e["alternatives"]:
            assert {"name", "where", "held_out_gain"} <= set(a)
        assert 0 <= e["p_corrected"] <= 1
        assert e["p_local"] is None or e["p_local"] <= e["p_corrected"]
    for part in ("train", "held_out"):
        for key in ("before_rms_mm", "after_rms_mm", "before_chi2_dof", "after_chi2_dof"):
            assert d["fit"][part][key] > 0
    assert d["fit"]["held_out"]["split"] in ("station", "block")
    assert d["fit"]["repeatability_floor_mm"] > 0
    for pair in d["not_separable"]:
        assert len(pair["effects"]) == 2
    for advice in d["advice"]:
        assert advice["reason"]
        assert all(len(q) > 0 for q in advice["poses_deg"])


def test_json_of_a_simulated_cell_with_an_effect(elastic_arm):
    result = elastic_arm
    d = json.loads(json.dumps(result.to_json(), allow_nan=False))
    check_contract(d)
    assert d["verdict"] == "explained"
    assert d["effects"][0]["name"] == "joint_compliance"
    assert d["effects"][0]["where"] == ["A2"]
    value = d["effects"][0]["parameters"]["A2.compliance_rad_per_Nm"]
    assert abs(value["value"] - 2.5e-6) < 4 * value["std"]
    assert d["mismatch"][0]["at"] == "A2"
    assert d["mismatch"][0]["depends_on"] == "gravity_torque_2"
    assert d["fit"]["held_out"]["after_rms_mm"] < 0.7 * d["fit"]["held_out"]["before_rms_mm"]
    assert "joint_compliance at A2" in words(result)


@pytest.mark.skipif(not (DATA / "example-none").exists(), reason="the shared data sets are not here")
def test_the_clean_example_is_clean_on_the_command_line():
    outcome = CliRunner().invoke(command, [str(DATA / "example-none"), "--json"])

    d = json.loads(outcome.stdout)
    check_contract(d)
    assert d["verdict"] == "none"
    assert d["effects"] == []


@pytest.mark.skipif(not (DATA / "example-compliance").exists(), reason="the shared data sets are not here")
def test_the_compliant_example_is_measured():
    truth = json.loads((DATA / "example-compliance.truth.json").read_text())["truth"]

    d = diagnose(load_observations(DATA / "example-compliance"), folds=2).to_json()

    assert d["verdict"] == "explained"
    assert [e["name"] for e in d["effects"]] == ["joint_compliance"]
    assert sorted(d["effects"][0]["where"]) == truth["where"]
    for axis, true in ((2, truth["compliance_rad_per_Nm"][1]), (3, truth["compliance_rad_per_Nm"][2])):
        found = d["effects"][0]["parameters"][f"A{axis}.compliance_rad_per_Nm"]
        assert abs(found["value"] - true) < 3 * found["std"]


def test_a_folder_that_is_no_recording_is_refused_in_one_sentence(tmp_path):
    outcome = CliRunner().invoke(command, [str(tmp_path)])

    assert outcome.exit_code != 0
    assert "Traceback" not in outcome.output
