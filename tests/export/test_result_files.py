"""JSON with its schema, and CSV: what is written can be read back, exactly."""

import copy
import csv
import io
import json

import numpy as np
import pytest

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_file import RobotInResult
from mbcacq.errors import ConfigError
from mbcacq.exports import tables
from mbcacq.exports.result_json import load_result, result_schema
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel
from mbcacq.model.json_text import fields_as_json, from_fields, sealed_text


def read(text):
    assert "\r\n" in text
    return list(csv.DictReader(io.StringIO(text)))


def test_the_result_meets_its_schema(solved):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(result_schema())
    jsonschema.validate(solved[0], result_schema())


def test_the_file_reads_back(solved, result_file):
    assert load_result(result_file) == solved[0]
    assert load_result(result_file.parent) == solved[0]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "mbcacq-other/2", "format 'mbcacq-result/1'"),
        ("T_flange_scanner", [[1, 2], [3, 4]], "T_flange_scanner"),
        ("covariance", [[1.0]], "the covariance is not"),
        ("robot", {"name": "x"}, r"robot\."),
        ("noise", {"scanner_mm": [1, 2, "x"], "joint_rad": []}, r"noise\.scanner_mm"),
    ],
)
def test_a_damaged_file_is_named(solved, tmp_path, key, value, message):
    result = copy.deepcopy(solved[0])
    result[key] = value
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result))
    with pytest.raises(ConfigError, match=message) as error:
        load_result(path)
    assert str(path) in str(error.value)


def test_an_axis_without_end_is_null_in_the_file_and_without_end_where_it_is_read():
    limits = np.array([(-1.0, 1.0), (-np.inf, np.inf)])
    chain = Chain(np.ones(2), *np.zeros((5, 2)))
    robot = RobotModel("turntable", chain, limits, np.zeros(2), np.zeros((2, 3)))
    text = json.dumps(fields_as_json(RobotInResult.of(robot, chain)), allow_nan=False)
    assert json.loads(text)["limits"][-1] == [None, None]
    assert np.array_equal(from_fields(RobotInResult, json.loads(text)).limits, limits)


def test_no_flipped_bit_of_a_result_file_changes_a_value_without_a_word(solved, tmp_path):
    path = tmp_path / "result.json"
    data = sealed_text(solved[0]).encode()
    path.write_bytes(data)
    assert load_result(path) == CalibratedCell.from_json(path).to_dict() == solved[0]
    random, refused = np.random.default_rng(1), 0
    for at in random.integers(len(data), size=100):
        changed = bytearray(data)
        changed[at] ^= 1 << int(random.integers(8))
        path.write_bytes(changed)
        for read in (load_result, lambda path: CalibratedCell.from_json(path).to_dict()):
            try:
                found = read(path)
            except ConfigError:
                refused += 1
                continue
            assert {key: value for key, value in found.items() if key in solved[0]} == solved[0]  # its checksum's name was hit, or a space
    assert refused > 0


def test_an_edited_result_says_how_it_can_be_used_all_the_same(solved, tmp_path):
    path = tmp_path / "result.json"
    edited = json.loads(sealed_text(solved[0]))
    edited["T_flange_scanner"][0][3] += 0.5
    path.write_text(json.dumps(edited))
    with pytest.raises(ConfigError, match="is not as it was written: bits changed, or it was edited; .* remove its 'sha256'"):
        load_result(path)
    del edited["sha256"]
    path.write_text(json.dumps(edited))
    assert load_result(path) == edited


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "\xff"])
def test_what_is_no_json_is_named(tmp_path, text):
    path = tmp_path / "result.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError, match=r"result\.json is not JSON"):
        load_result(path)


def test_parameters_to_the_last_bit(solved):
    rows = read(tables.parameters_csv(solved[0]))
    for row, p in zip(rows, solved[0]["parameters"], strict=True):
        assert (row["name"], float(row["value"]), float(row["error"]), row["unit"]) == (p["name"], p["value"], p["error"], p["unit"])
        assert row["std"] == "" if p["std"] is None else float(row["std"]) == p["std"]


def test_the_covariance_to_the_last_bit(solved):
    rows = read(tables.covariance_csv(solved[0]))
    assert [r["name"] for r in rows] == solved[0]["names"]
    np.testing.assert_array_equal([[float(r[n]) for n in solved[0]["names"]] for r in rows], solved[0]["covariance"])


def test_the_verification_csv_has_every_place(solved):
    rows = read(tables.verification_csv(solved[0]))
    assert rows[0]["station"] == "b1"
    assert (rows[0]["ball_a"], rows[0]["ball_b"]) == ("9", "10")
    assert float(rows[0]["certified_mm"]) == pytest.approx(600.0)
    assert float(rows[0]["after_mm"]) == solved[0]["verification"]["places"][0]["after_mm"]
    assert tables.verification_csv(solved[0] | {"verification": None}).strip().startswith("station,")


def test_residuals_are_the_noise_that_was_put_in(solved):
    result, observations = solved[:2]
    rows = read(tables.residuals_csv(result, observations))
    assert len(rows) == 150 * 8
    size = np.array([[float(r[k]) for k in ("dx_mm", "dy_mm", "dz_mm")] for r in rows])
    scaled = np.array([[float(r[f"{k}_over_sigma"]) for k in ("dx", "dy", "dz")] for r in rows])
    assert 0.0045 < np.sqrt(np.mean(size**2)) < 0.009  # 5 um of noise and 5 urad of joint repeatability
    assert 0.85 < scaled.std() < 1.1


def test_a_cell_that_a_spreadsheet_would_compute_is_quoted(solved):
    result = copy.deepcopy(solved[0])
    for name, p in zip(("=cmd()", "+1", "-x", "@SUM(A1)"), result["parameters"], strict=False):
        p["name"] = name
    result["names"][0] = "=cmd()"
    rows = read(tables.parameters_csv(result))
    assert [row["name"] for row in rows[:4]] == ["'=cmd()", "'+1", "'-x", "'@SUM(A1)"]
    negative = [p["error"] for p in result["parameters"] if p["error"] < 0]
    assert [float(row["error"]) for row in rows if row["error"].startswith("-")] == negative  # numbers stay numbers
    first = read(tables.covariance_csv(result))
    assert first[0]["name"] == "'=cmd()"
    assert "'=cmd()" in first[0]
