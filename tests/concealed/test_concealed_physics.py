"""plans/concealed.yaml: what is concealed in the fake cell is found, and a calibration with it is better at the bar."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import mbcacq
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.plan import expand, load
from mbcacq.report.write import report_from_result
from mbcacq.workflow.calibrate_with_found import CalibratedWithFound, calibrate_with_found

PLAN = Path(__file__).parents[2] / "plans" / "concealed.yaml"


@pytest.fixture(scope="module")
def hidden() -> list[dict]:
    return yaml.safe_load(PLAN.read_text(encoding="utf-8"))["fake"]["hidden"]


def diagnosed_and_calibrated(hidden) -> tuple[mbcacq.DiagnosisResult, CalibratedWithFound]:
    loaded = load(PLAN)
    recording, _ = observe(loaded, expand(loaded), Scenario(0, "concealed", 1, (), 1, 1.0), hidden)
    found = mbcacq.diagnose(recording, workers=1)
    return found, calibrate_with_found(found)


@pytest.fixture(scope="module")
def both(hidden, computed_once) -> tuple[mbcacq.DiagnosisResult, CalibratedWithFound]:
    return computed_once("concealed-physics", lambda: diagnosed_and_calibrated(hidden))


@pytest.fixture(scope="module")
def found(both) -> mbcacq.DiagnosisResult:
    return both[0]


@pytest.fixture(scope="module")
def calibrated(both) -> CalibratedWithFound:
    return both[1]


def test_all_that_is_concealed_is_found_and_nothing_else(found, hidden):
    reported = {(e.name, w) for e in found.effects for w in e.where}

    assert reported == {(h["name"], h.get("where", "scanner")) for h in hidden}
    assert found.verdict == "explained"


def test_the_bar_is_better_after_geometry_and_again_after_effects(calibrated):
    before, geometry, effects = (np.abs(e).mean() for e in calibrated.stages.values())

    assert list(calibrated.stages) == ["before", "after calibration", "after effects"]
    assert geometry < 0.02 < before  # what repeats is learnt as a smooth function of posture, before anything has a name
    assert effects < geometry


def test_result_and_picture_are_written_and_the_result_is_the_cell_with_effects(calibrated, tmp_path):
    result, picture = calibrated.write(tmp_path / "with-effects")

    svg = picture.read_text(encoding="utf-8")
    assert all(name in svg for name in (*calibrated.stages, *calibrated.places))
    assert svg.count("<rect") == 1 + 3 + 3 * len(calibrated.places)
    terms = json.loads(result.read_text(encoding="utf-8"))["effects"]["terms"]
    # A1 turns by less than one period of its gear error here: nothing shows that it repeats, so it is kept as a function of A1's angle.
    assert {t["name"] for t in terms} == {"joint_compliance", "unknown", "scanner_warmup"}
    assert {tuple(t["where"]) for t in terms if t["name"] == "unknown"} == {("A1",)}


def test_the_report_of_the_run_shows_the_cell_with_effects(calibrated, found, tmp_path):
    geometry = calibrated.geometry.to_dict() | {"verification": calibrated.by_geometry.to_dict()}
    about = {"diagnosis": json.loads(found.to_json()), "pictures": None, "with_effects": calibrated.result()}
    page = report_from_result(geometry, path=tmp_path / "report.html", run_info=about).read_text(encoding="utf-8")

    for name, errors in calibrated.stages.items():
        assert name in page
        assert f"mean {np.abs(errors).mean():.4f} mm" in page
    assert f"noise alone: {calibrated.result()['verification']['expected_mean_mm']:.4f} mm" in page


def test_a_limit_of_the_run_is_the_limit_of_its_cell_with_effects(found):
    assert calibrate_with_found(found, limit_mm=0.05).result()["verification"]["limit_mm"] == 0.05


def test_without_effects_there_are_two_stages_and_the_text_says_so(calibrated):
    nothing = replace(calibrated, with_effects=None, by_effects=None)

    assert list(nothing.stages) == ["before", "after calibration"]
    assert "No effect was found" in nothing.text
