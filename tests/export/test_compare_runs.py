"""Two recordings of one arm: what changed is found with its size, and what did not is not called changed."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.calibration.result_io import without_prior
from mbcacq.cli.compare import command
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.workflow.changes_page import write_page
from mbcacq.workflow.compare_runs import compare_results, compare_runs


def another(result, seed, **errors):
    """The same cell measured again. The data move by their own noise, some parameters by a known change (rad, mm) as well. The estimates
    lean towards nominal as the prior of the links lets them."""
    again = json.loads(json.dumps(result))
    rng = np.random.default_rng(seed)
    names, own = again["names"], without_prior(result)
    changed = np.array([errors.get(name.removeprefix("hand_eye."), 0.0) for name in names])
    in_the_data = changed + rng.multivariate_normal(np.zeros(len(names)), own.covariance)
    moved = dict(zip(names, np.array(again["covariance"]) @ np.linalg.solve(own.covariance, in_the_data), strict=True))
    for p in again["parameters"]:
        if p["std"] is not None and not p["name"].startswith(("hand_eye", "ball")):
            p["error"] += moved[p["name"]]
    twist = np.array([moved.get(f"hand_eye.{c}", 0.0) for c in ("x", "y", "z", "rx", "ry", "rz")])
    again["T_flange_scanner"] = (np.array(result["T_flange_scanner"]) @ se3.exp(twist)).tolist()
    return again


def test_a_changed_axis_is_named_with_its_size(solved):
    result = solved[0]
    found = compare_results(another(result, 1), another(result, 2, theta_3=np.radians(0.2)))
    (row,) = [r for r in found.rows if r.name == "theta_3"]
    assert row.unit == "deg"
    assert row.significant
    assert abs(row.change[0] - 0.2) < row.change[1]
    assert found.together.p_value < 1e-6


def test_a_scanner_that_was_knocked_is_named(solved):
    result = solved[0]
    found = compare_results(another(result, 1), another(result, 2, y=0.3))
    assert "hand_eye.y" in [row.name for row in found.changed]


def test_two_recordings_of_an_unchanged_cell_differ_by_chance(solved):
    """The joint test is calibrated: over 40 pairs its p-values are uniform, and rows are marked in a few comparisons at most."""
    result = solved[0]
    pairs = [compare_results(another(result, 2 * k), another(result, 2 * k + 1)) for k in range(40)]
    assert 0.3 < np.mean([pair.together.p_value for pair in pairs]) < 0.7
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
    assert "theta_3" in outcome.output.split("Changed beyond chance:")[1]
    kept = json.loads(CliRunner().invoke(command, [*folders, "--json"]).stdout)
    assert kept["format"] == "mbcacq-run-comparison/1"
    assert kept["rows"] == compare_runs(*folders).to_dict()["rows"]


def leaning(information, prior_std, prior_mean, true):
    """A result.json of two links: what data of this information (2, 2), without noise, and this prior make of the true errors."""
    prior = np.diag(np.square(prior_std) ** -1.0)
    C = np.linalg.inv(information + prior)
    found = C @ (information @ true + prior @ prior_mean)
    rows = [
        {"name": name, "value": e, "error": e, "unit": "mm", "std": float(np.sqrt(v)), "status": "prior", "prior_std": s, "prior_mean": m}
        for name, e, v, s, m in zip(("a_1", "a_2"), found, np.diag(C), prior_std, prior_mean, strict=True)
    ]
    return {
        "names": ["a_1", "a_2"],
        "covariance": C.tolist(),
        "parameters": rows,
        "T_flange_scanner": np.eye(4).tolist(),
        "robot": {"sign": [1.0, 1.0]},
    }


def test_without_the_prior_an_estimate_is_what_the_data_say():
    """The least-squares estimate and its covariance come back, however strongly both lean, towards whatever mean."""
    information, true = np.array([[3.0, 2.5], [2.5, 4.0]]), np.array([0.7, -0.4])
    result = leaning(information, [0.3, 0.5], [0.1, 0.0], true)
    assert abs(result["parameters"][0]["error"] - true[0]) > 0.3
    own = without_prior(result)
    np.testing.assert_allclose([own.error["a_1"], own.error["a_2"]], true, atol=1e-12)
    np.testing.assert_allclose(own.covariance, np.linalg.inv(information), rtol=1e-12)
    assert own.known


def test_a_result_that_does_not_say_its_prior_is_said_to_lean(solved):
    older = json.loads(json.dumps(solved[0]))
    for p in older["parameters"]:
        p.pop("prior_std", None)
    found = compare_results(older, solved[0])
    assert found.leaning
    assert "lean towards zero" in found.how
    assert not compare_results(solved[0], solved[0]).leaning


def test_the_page_shows_every_change_with_its_chart(solved, tmp_path):
    one, two = another(solved[0], 1), another(solved[0], 2, theta_3=0.004)
    found = compare_results(one, two, ("monday", "friday"))
    html = write_page(found, tmp_path / "changes.html", (one, two)).read_text(encoding="utf-8")
    assert all(row.title in html for row in found.rows)
    assert "Changed beyond chance: theta_3" in html
    drawn = [
        json.loads(text)
        for text in re.findall(r'<script type="application/json" id="data-(?:mount-)?(?:lengths|angles)">(.*?)</script>', html)
    ]
    shown = {name: (x, e) for f in drawn for t in f["data"] for name, x, e in zip(t["y"], t["x"], t["error_x"]["array"], strict=True)}
    for row in found.rows:
        if row.what in ("parameter", "hand-eye") and row.change is not None:
            assert shown[row.title] == pytest.approx(row.change)


def test_a_page_of_one_recording_is_asked_of_the_report(tmp_path):
    outcome = CliRunner().invoke(command, [str(tmp_path), "--report", str(tmp_path / "x.html")])
    assert "take mbcacq report" in str(outcome.exception)


def test_the_table_cuts_no_word_at_eighty_columns(solved, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    files = []
    for name, content in (("monday", another(solved[0], 1)), ("friday", another(solved[0], 2, theta_3=0.004))):
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(json.dumps({k: v for k, v in content.items() if k != "sha256"}))
    shown = CliRunner().invoke(command, [str(file) for file in files]).stdout
    table = [line for line in shown.splitlines() if line[:1] in "│┃┏┡└"]
    assert max(map(len, table)) <= 80
    assert "…" not in "".join(table)
    for row in compare_runs(*files).table:
        for text in row[1:]:
            assert all(word in shown for word in text.replace("−", "-").split())
