"""A result.json that is damaged, or is no JSON at all, is refused where it is read, by file and key; never by the name of a Python error."""

from __future__ import annotations

import copy
import json
import re

import pytest

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_io import read_result
from mbcacq.errors import ConfigError
from mbcacq.exports.result_json import load_result
from mbcacq.model.json_text import sealed_text
from mbcacq.workflow.load import unsealed_note

READERS = [CalibratedCell.from_json, load_result, read_result]
PYTHON = re.compile(r"NoneType|KeyError|TypeError|ValueError|Expecting|codec|subscriptable|broadcast|reshape|instance of|tuple|dictionary")


def _at(content, path, value):
    """A copy of the content with another value at a path of keys; None takes the key away."""
    content = copy.deepcopy(content)
    *above, last = path
    at = content
    for key in above:
        at = at[key]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return content


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        (("robot", "calibrated", "theta"), [1, 2], "robot.calibrated.theta: it has 2 values, and the arm has 6 axes"),
        (("robot", "nominal", "d"), [0.0] * 7, "robot.nominal.d: it has 7 values"),
        (("robot",), None, "the key 'robot' is missing"),
        (("robot",), [1], "robot: it is no object of keys and values"),
        (("T_flange_scanner",), "x", "T_flange_scanner: it is no list"),
        (("T_flange_scanner", 0, 3), float("nan"), "T_flange_scanner.0.3: it is not finite"),
        (("covariance",), [], "the covariance is not"),
        (("noise", "joint_rad"), [1e-5], "noise.joint_rad: it has 1 values"),
        (("noise", "scanner_mm"), None, "the key 'noise.scanner_mm' is missing"),
    ],
)
def test_a_damaged_value_is_named_by_file_and_key(solved, tmp_path, read, path, value, sentence):
    file = tmp_path / "result.json"
    file.write_text(json.dumps(_at(solved[0], path, value)), encoding="utf-8")
    with pytest.raises(ConfigError, match=re.escape(sentence)) as error:
        read(file)
    assert str(file) in str(error.value)
    assert not PYTHON.search(str(error.value).replace(str(file), ""))


@pytest.mark.parametrize("path", [("names",), ("preliminary",)])
def test_a_cell_that_cannot_be_made_of_a_file_is_named_by_the_file(solved, tmp_path, path):
    file = tmp_path / "result.json"
    content = _at(solved[0], path, None if path == ("preliminary",) else solved[0]["names"][::-1])
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"result\.json is damaged") as error:
        CalibratedCell.from_json(file)
    assert not PYTHON.search(str(error.value).replace(str(file), ""))


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", "it is empty"),
        (b" \n", "it is empty"),
        (b'{"format":\n "mbcacq', "it breaks off or is malformed in line 2, column"),
        (b"\x89PNG\x00\xff", "it is not UTF-8 text"),
        (b"[" * 100_000, "its brackets are nested deeper"),
        (b"[" + b"1" * 10_000 + b"]", "a number in it has too many digits"),
    ],
)
def test_what_is_no_json_is_said_in_words(tmp_path, read, data, fault):
    file = tmp_path / "result.json"
    file.write_bytes(data)
    with pytest.raises(ConfigError, match=re.escape(f"result.json is not JSON ({fault}")) as error:
        read(file)
    assert not PYTHON.search(str(error.value).replace(str(file), ""))


def test_a_result_whose_checksum_was_taken_out_is_said_to_be_unsealed(tmp_path, solved):
    path = tmp_path / "result.json"
    path.write_text(sealed_text(solved[0]))
    assert unsealed_note(path) == unsealed_note(tmp_path) == []
    path.write_text(json.dumps({key: value for key, value in json.loads(path.read_text()).items() if key != "sha256"}))
    (note,) = unsealed_note(tmp_path)
    assert note.startswith(f"unsealed: {path} carries no checksum")
