"""The library: lazy, complete, and results that pickle, go to and from JSON, and show themselves in a notebook."""

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dry_runs import few_views, plan_file

import mbcacq
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import from_fields
from mbcacq.workflow.acquire import solver_cell
from mbcacq.workflow.simulate import simulate_poses

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def plan():
    return mbcacq.load_plan(ROOT / "plans" / "quick.yaml")


@pytest.fixture(scope="module")
def data(plan):
    return mbcacq.simulate(plan, noise=True, seed=2)


@pytest.fixture(scope="module")
def cell(data):
    return mbcacq.calibrate(data, mbcacq.CalibrationOptions(kinematics=False))


def test_importing_the_library_imports_nothing_else():
    code = "import sys; import mbcacq; print(*[m for m in sys.modules if m.startswith('mbcacq') or m in ('numpy', 'typing', 'pydantic')])"
    out = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True, check=True, env={"PYTHONPATH": str(ROOT)})
    assert out.stdout.split() == ["mbcacq"]


@pytest.mark.parametrize("name", [name for name in mbcacq.__all__ if name != "__version__"])
def test_every_public_name_is_there_with_documentation(name):
    assert getattr(mbcacq, name).__doc__
    assert name in dir(mbcacq)


def test_functions_are_functions_after_their_rooms_are_imported():
    import mbcacq.exports
    import mbcacq.report
    import mbcacq.workflow.run

    assert callable(mbcacq.run)
    assert callable(mbcacq.export)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        mbcacq.calibrat  # noqa: B018


def test_type_checkers_are_promised_types():
    assert (Path(mbcacq.__file__).parent / "py.typed").exists()


def test_a_calibration_survives_pickling(cell, data):
    copy = pickle.loads(pickle.dumps(cell))
    np.testing.assert_array_equal(copy.covariance, cell.covariance)
    assert copy.to_dict() == cell.to_dict()


def test_points_of_an_instrument_in_the_base_are_not_placed_by_joint_angles(cell, data):
    fixed = replace(cell, own_fit=None, extra={**cell.to_dict(), "measurement": "target_in_base"})
    with pytest.raises(ConfigError, match="the instrument stands in the base"):
        fixed.to_base(data.q[data.pose], data.xyz)


@pytest.mark.parametrize("by", ["text", "file", "folder"])
def test_a_cell_read_from_json_measures_as_the_calibration_does(cell, data, tmp_path, by):
    (tmp_path / "result.json").write_text(cell.to_json(), encoding="utf-8")
    source = {"text": cell.to_json(), "file": tmp_path / "result.json", "folder": str(tmp_path)}[by]
    again = mbcacq.CalibratedCell.from_json(source)
    q, xyz = data.q[data.pose], data.xyz
    np.testing.assert_allclose(again.to_base(q, xyz), cell.to_base(q, xyz), atol=1e-9)
    np.testing.assert_allclose(
        again.point_covariance(q, xyz, measuring=True), cell.point_covariance(q, xyz, measuring=True), rtol=1e-9, atol=1e-15
    )
    assert again.names == cell.names
    np.testing.assert_array_equal(again.noise.joint, cell.noise.joint)
    assert json.loads(again.to_json()) == json.loads(cell.to_json())


@pytest.mark.parametrize("text", ["{}", "{", '{"format": "mbcacq-result/1"}'])
def test_what_is_no_result_is_refused(text):
    with pytest.raises(ConfigError):
        mbcacq.CalibratedCell.from_json(text)


def test_a_damaged_result_is_refused_by_name(cell):
    content = cell.to_dict()
    with pytest.raises(ConfigError, match="damaged"):
        mbcacq.CalibratedCell.from_dict(content | {"names": content["names"][::-1]})
    with pytest.raises(ConfigError, match="damaged"):
        mbcacq.CalibratedCell.from_dict(content | {"covariance": [[1.0]]})


def test_a_calibration_knows_which_poses_took_part(cell, data):
    assert cell.took_part(data)
    from dataclasses import replace

    other = replace(data, q=data.q + 1e-3)
    assert not cell.took_part(other)
    again = mbcacq.CalibratedCell.from_json(cell.to_json())
    assert again.took_part(data) is None  # the same stations; result.json does not list poses


def test_verification_goes_to_json_and_back(cell):
    from mbcacq.calibration.verification import JudgedFigure, VerifiedPair

    made = mbcacq.Verification(
        places=(VerifiedPair(station="b1", balls=(1, 2), certified_mm=735.0, before_mm=0.4, after_mm=0.02, expected_mm=0.03),),
        limit_mm=0.1,
        independent=True,
        figures=(JudgedFigure(name="x", value_mm=0.02, count=1, uncertainty_mm=None, limit_mm=0.1, verdict="pass"),),
    )
    assert from_fields(mbcacq.Verification, json.loads(json.dumps(made.to_dict()))) == made
    assert mbcacq.Verification(places=()).to_dict() is None
    assert pickle.loads(pickle.dumps(made)) == made


def test_comparison_is_a_sequence_that_goes_to_json_and_back(data):
    rows = mbcacq.compare(data, ["nominal", "hand-eye only"], held_out=False)
    assert [row.method for row in rows] == ["nominal", "hand-eye only"]
    assert rows[1].fit_mm < rows[0].fit_mm
    assert from_fields(mbcacq.Comparison, json.loads(json.dumps(rows.to_dict()))) == rows
    assert pickle.loads(pickle.dumps(rows)) == rows


def test_results_show_themselves_in_a_notebook(cell, data):
    rows = mbcacq.compare(data, ["nominal"], held_out=False)
    for shown in (cell, mbcacq.CalibratedCell.from_json(cell.to_json()), mbcacq.verify(data, cell), rows):
        assert shown._repr_html_().startswith("<table>")
        assert len(repr(shown)) < 200
    assert "hand_eye.x" in cell._repr_html_()


def test_names_from_a_file_are_escaped_in_html(cell):
    content = cell.to_dict()
    content["robot"] = content["robot"] | {"name": "<script>"}
    assert "<script>" not in mbcacq.CalibratedCell.from_dict(content)._repr_html_()


def test_a_calibrated_cell_is_simulated_as_it_was_calibrated(plan, cell, tmp_path):
    (tmp_path / "result.json").write_text(cell.to_json(), encoding="utf-8")
    by_object, by_file = mbcacq.simulate(plan, cell), mbcacq.simulate(plan, tmp_path)
    np.testing.assert_array_equal(by_object.xyz, by_file.xyz)
    assert np.abs(by_object.xyz - mbcacq.simulate(plan).xyz).max() > 0


def test_simulation_of_a_plan_is_that_of_its_poses(plan):
    from mbcacq.plan import expand

    np.testing.assert_array_equal(mbcacq.simulate(plan).xyz, simulate_poses(plan, expand(plan)).xyz)
    assert all(s.T_base_station is None for s in solver_cell(plan).stations)


def test_observations_are_exported_and_loaded(data, tmp_path):
    written = mbcacq.export(data, observations=tmp_path / "set")
    assert written == [{"simulated": True, "file": str(tmp_path / "set"), "poses": data.n_poses, "centres": data.n_centres}]
    np.testing.assert_allclose(mbcacq.load_observations(tmp_path / "set").xyz, data.xyz, atol=1e-9)
    with pytest.raises(ConfigError, match="already holds a set"):
        mbcacq.export(data, observations=tmp_path / "set")


def test_results_are_exported_from_a_calibration_and_from_its_file(cell, tmp_path):
    from_object = mbcacq.export(cell, results=tmp_path / "a", simulated_anyway=True)
    (tmp_path / "result.json").write_text(cell.to_json(), encoding="utf-8")
    mbcacq.export(tmp_path / "result.json", results=tmp_path / "b", simulated_anyway=True)
    assert {Path(w["file"]).name for w in from_object} > {"result.json", "parameters.csv"}
    assert (tmp_path / "a" / "parameters.csv").read_text() == (tmp_path / "b" / "parameters.csv").read_text()


def test_nothing_to_export_is_said(data):
    with pytest.raises(ConfigError, match="nothing to export"):
        mbcacq.export(data)


def test_a_calibration_is_reported(cell, tmp_path):
    page = mbcacq.write_report(cell, tmp_path / "report.html")
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")
    with pytest.raises(ConfigError, match="where the report is to go"):
        mbcacq.write_report(cell)


def test_a_real_arm_is_not_moved_without_an_operator(tmp_path):
    """The address is of no loopback interface; nothing is opened."""
    import shutil

    shutil.copytree(ROOT / "plans", tmp_path / "plans")
    path = tmp_path / "plans" / "quick.yaml"
    path.write_text(
        path.read_text(encoding="utf-8").replace("bind: 127.0.0.1", "bind: 192.0.2.1, controller_ip: 192.0.2.2"), encoding="utf-8"
    )
    with pytest.raises(ConfigError, match="this would move"):
        mbcacq.run(path, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_dry_run_returns_the_calibrated_cell(tmp_path):
    plan, seen = plan_file(tmp_path, few_views), []
    done = mbcacq.run(plan, dry_run=True, seed=5, out=tmp_path / "run", operator=mbcacq.Operator(subscribers=(seen.append,)))
    assert done.folder == tmp_path / "run"
    assert json.loads((done.folder / "result.json").read_text())["fit"]["rms_mm"] == done.calibration.fit.rms_mm
    alone = mbcacq.calibrate(done.folder, mbcacq.CalibrationOptions(kinematics=False))  # what one station determines
    assert done.calibration.fit.rms_mm == alone.fit.rms_mm
    assert not done.calibration.errors.any()
    assert seen
    assert mbcacq.verify(done.folder, done.folder).places == done.verification.places
    with pytest.raises(ConfigError, match="exclude each other"):
        mbcacq.run(plan, out="a", resume="b")


def test_a_diagnosis_goes_to_json_and_back():
    figures = {"before_rms_mm": 0.1, "after_rms_mm": 0.02, "before_chi2_dof": 9.0, "after_chi2_dof": 1.0}
    content = {
        "format": "mbcacq-diagnosis/1",
        "verdict": "explained",
        "mismatch": [],
        "effects": [
            {
                "name": "scanner_scale",
                "where": ["scanner"],
                "parameters": {"scale_ppm": {"value": 300.0, "std": 12.0}},
                "p_value": 1e-9,
                "held_out_gain": 0.9,
                "alternatives": [],
            }
        ],
        "fit": {"train": figures, "held_out": figures | {"split": "station"}, "repeatability_floor_mm": 0.02},
        "not_separable": [],
        "advice": [],
    }
    found = mbcacq.DiagnosisResult.from_json(json.dumps(content))
    again = mbcacq.DiagnosisResult.from_json(found.to_json())
    assert again.to_dict() == found.to_dict()
    assert found.effects[0].parameters["scale_ppm"].value == 300.0
    assert pickle.loads(pickle.dumps(found)).to_dict() == found.to_dict()
    assert "scanner_scale at scanner" in repr(found)
    assert "300" in found._repr_html_()
    with pytest.raises(ConfigError, match="pictures are drawn"):
        again.pictures()
    with pytest.raises(ConfigError, match="no diagnosis"):
        mbcacq.DiagnosisResult.from_json("{}")
