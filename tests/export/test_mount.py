"""Nothing that was not determined leaves as if it were: a reflector has no orientation, and an instrument in the base is on no flange."""

import json

import numpy as np
import pytest
import read_back
import yaml
from test_folder import run

from mbcacq.errors import ConfigError
from mbcacq.exports.folder import contents
from mbcacq.exports.format import Targets
from mbcacq.exports.scan_correction import place_scan

WHY = "only the target's position is measured"


@pytest.fixture
def reflector(solved):
    """The result of a tracker that measures a reflector: the rotation of the hand-eye is held."""
    result = json.loads(json.dumps(solved[0])) | {"measurement": "target_in_base"}
    result["T_flange_scanner"] = [[1, 0, 0, 10.0], [0, 1, 0, 20.0], [0, 0, 1, 90.0], [0, 0, 0, 1]]
    result["held"] |= {f"hand_eye.{c}": WHY for c in ("rx", "ry", "rz")}
    return result


def test_an_orientation_that_was_not_measured_is_in_no_file(reflector):
    files = contents(reflector, Targets())
    assert "tool_data.txt" not in files
    assert b'name="flange"' in files["arm.mjcf.xml"]
    assert b'name="scanner"' not in files["arm.mjcf.xml"]
    assert b'name="target"' not in files["arm.mjcf.xml"]
    assert f"# the orientation of the target on the flange was not determined ({WHY})" in files["kinematics.yaml"].decode()


def test_a_format_that_needs_it_says_why_when_asked_for(reflector):
    with pytest.raises(ConfigError, match="orientation of the target on the flange was not determined"):
        contents(reflector, Targets(only=("kuka",)))


def test_what_the_user_held_is_exported(reflector):
    held = reflector["held"] | {f"hand_eye.{c}": "held on request" for c in ("rx", "ry", "rz")}
    files = contents(reflector | {"held": held}, Targets(only=("kuka",)))
    np.testing.assert_allclose(read_back.tool_data(files["tool_data.txt"].decode("latin-1"), 1)[:3, 3], [10, 20, 90])


def test_an_instrument_in_the_base_is_eye_on_base_to_ros_and_no_scanner_on_the_controller(reflector):
    determined = reflector | {"held": {}}
    files = contents(determined, Targets())
    assert b'"mbcacq target"' in files["tool_data.txt"]
    assert b'<site name="target"' in files["arm.mjcf.xml"]
    calib = yaml.safe_load(files["mbcacq.calib"])
    place = np.array(determined["stations"][0]["T_base_station"])[:3, 3] / 1e3
    assert calib["parameters"]["calibration_type"] == "eye_on_base"
    np.testing.assert_allclose([calib["transform"]["translation"][c] for c in "xyz"], place)
    assert b"--frame-id base_link" in files["static_transform.sh"]


@pytest.mark.parametrize(
    ("measurement", "sentence"), [("target_in_base", "does not say where a scanner is"), ("artefact_in_scanner", "a scan cannot be placed")]
)
def test_a_scan_is_not_placed_with_it(reflector, measurement, sentence):
    with pytest.raises(ConfigError, match=sentence):
        place_scan(reflector | {"measurement": measurement}, np.zeros(6), np.zeros((4, 3)))


def test_the_command_line_says_what_is_left_out(reflector, tmp_path):
    path = tmp_path / "result.json"
    path.write_text(json.dumps({k: v for k, v in reflector.items() if k != "sha256"}), encoding="utf-8")
    outcome = run(path, "--results", tmp_path / "out")
    assert "its frame is in no file for controllers, ROS or simulators" in outcome.stderr
    assert not (tmp_path / "out" / "tool_data.txt").exists()
