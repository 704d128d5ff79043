"""Two recordings of one arm: what changed is found with its size, and what did not is not called changed."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.cli.compare import command
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.workflow.compare_runs import compare_results, compare_runs


def another(result, seed, **errors):
    """The same cell measured again: every parameter of the arm moved by its own noise, some by a known error (rad, mm) as well."""
    again = json.loads(json.dumps(result))
    rng = np.random.default_rng(seed)
    names = again["names"]
    noise = dict(zip(names, rng.multivariate_normal(np.zeros(len(names)), np.array(again["covariance"])), strict=True))
    for p in again["parameters"]:
        if p["std"] is not None and not p["name"].startswith(("hand_eye", "ball")):
            p["error"] += noise[p["name"]] + errors.get(p["name"], 0.0)
    twist = np.array([noise.get(f"hand_eye.{c}", 0.0) + errors.get(c, 0.0) for c in ("x", "y", "z", "rx", "ry", "rz")])
    again["T_flange_scanner"] = (np.array(result["T_flange_scanner"]) @ se3.exp(twist)).tolist()
    return again


def test_a_changed_axis_is_named_with_its_size(solved):
    result = solved[0]
    found = compare_results(another(result, 1), another(result, 2, theta_3=np.radians(0.2)))
    (row,) = [r for r in found.rows if r.name == "theta_3"]
    assert row.unit == "deg"
    assert row.significant
    assert abs(row.change[0] - 0.2) < row.change[1]
    assert found.p_value < 1e-6


def test_a_scanner_that_was_knocked_is_named(solved):
    result = solved[0]
    found = compare_results(another(result, 1), another(result, 2, y=0.3))
    assert "hand_eye.y" in [row.name for row in found.changed]


def test_two_recordings_of_an_unchanged_cell_differ_by_chance(solved):
    """The joint test is calibrated: over 40 pairs its p-values are uniform, and rows are marked in a few comparisons at most."""
    result = solved[0]
    pairs = [compare_results(another(result, 2 * k), another(result, 2 * k + 1)) for k in range(40)]
    assert 0.3 < np.mean([pair.p_value for pair in pairs]) < 0.7
    assert sum(bool(pair.changed) for pair in pairs) <= 7


def test_what_one_recording_holds_is_not_compared(solved):
    one, two = another(solved[0], 1), another(solved[0], 2)
    held = next(p for p in two["parameters"] if p["name"] == "theta_4")
    held |= {"status": "held", "std": None}
    (row,) = [r for r in compare_results(one, two).rows if r.name == "theta_4"]
    assert (row.change, row.why_not) == (None, "held in the second")


def test_another_arm_is_refused(solved):
    two = another(solved[0], 2)
    two["robot"]["name"] = "another"
    with pytest.raises(ConfigError, match="same arm"):
        compare_results(solved[0], two)


def test_the_command_prints_what_changed_and_takes_the_result_with_effects(solved, tmp_path):
    folders = []
    for name, content in (("monday", another(solved[0], 1)), ("friday", another(solved[0], 2, theta_3=0.004))):
        inner = tmp_path / name / "with-effects"
        inner.mkdir(parents=True)
        (tmp_path / name / "result.json").write_text("{}")  # the one without effects is not asked for
        (inner / "result.json").write_text(json.dumps({k: v for k, v in content.items() if k != "sha256"}))
        folders.append(str(tmp_path / name))
    outcome = CliRunner().invoke(command, folders)
    assert outcome.exit_code == 0, outcome.exception
    assert "theta_3" in outcome.output.split("Changed beyond chance (!):")[1]
    kept = json.loads(CliRunner().invoke(command, [*folders, "--json"]).stdout)
    assert kept["format"] == "mbcacq-run-comparison/1"
    assert kept["rows"] == compare_runs(*folders).to_dict()["rows"]
