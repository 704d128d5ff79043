"""The notebook-style tutorials are executed block by block in a kernel, as a reader would, and are the notebooks."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "_make"))

import notebooks  # noqa: E402

SCALE_IS_FOUND = """
assert data.n_poses == true.n_poses
assert abs(again.to_base(q, centre) - cell.to_base(q, centre)).max() < 1e-9
assert checked.independent
assert abs(checked.errors("before")).max() < 0.03 < 0.05 < abs(checked.errors("after")).max()
(scale,) = found.effects
assert {scale.name, *(a.name for a in scale.alternatives)} >= {"scanner_scale", "artefact_expansion"}
(ppm,) = scale.parameters.values()
assert abs(ppm.value - 300.0) < 4 * ppm.std
import pickle
copy = pickle.loads(pickle.dumps(found))
assert copy.pictures() == found.pictures() and copy.to_dict() == found.to_dict() and copy.text == found.text
assert "scanner_scale" in found.write_html("diagnosis.html").read_text(encoding="utf-8")
assert mbcacq.DiagnosisResult.from_json(found.to_json()).to_dict() == found.to_dict()
"""


UNCERTAINTY_FALLS = """
assert data.n_poses >= 12
assert sigma[-1] < sigma[0]
assert list(curve.data[0]["y"]) == sigma
"""
HOSE_IS_FOUND = """
assert {effect.name for effect in before.effects} <= {"unknown"}
assert "A1" in {place for effect in before.effects for place in effect.where}
(hose,) = after.effects
assert hose.name == "hose_pull" and hose.where == ("A1",)
assert abs(hose.parameters["A1.pull_rad"].value - 4e-4) < 4 * hose.parameters["A1.pull_rad"].std
"""
ENDINGS = {"csv-to-diagnosis": SCALE_IS_FOUND, "plan-for-your-arm": UNCERTAINTY_FALLS, "add-an-effect": HOSE_IS_FOUND}


FIGURES = {"csv-to-diagnosis": 3, "plan-for-your-arm": 1, "add-an-effect": 1}
TABLES = {"csv-to-diagnosis": 3, "plan-for-your-arm": 1, "add-an-effect": 1}


def cells(notebook):
    return [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]]


def shown(notebook):
    """Number of figures and of tables that its outputs hold."""
    kinds = [output["data"] for cell in notebook["cells"] for output in cell.get("outputs", ()) if "data" in output]
    tables = ["<table" in "".join(data.get("text/html", "")) for data in kinds]
    return sum("image/svg+xml" in data for data in kinds), sum(tables)


@pytest.mark.parametrize("name", notebooks.TUTORIALS)
def test_a_tutorial_runs_in_a_kernel_and_finds_what_it_promises(name, monkeypatch):
    made = notebooks.notebook(ROOT / "docs" / "tutorials" / notebooks.TUTORIALS[name])
    made["cells"].append(notebooks._cell("code", ENDINGS[name]) | {"id": "ending"})
    monkeypatch.setattr(notebooks, "notebook", lambda page: made)
    assert shown(notebooks.executed(name)) == (FIGURES[name], TABLES[name])


@pytest.mark.parametrize("name", notebooks.TUTORIALS)
def test_the_notebook_is_the_tutorial_with_its_tables_and_figures(name):
    kept = json.loads((notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    made = notebooks.notebook(ROOT / "docs" / "tutorials" / notebooks.TUTORIALS[name])
    assert cells(kept) == cells(made), "run python docs/_make/notebooks.py"
    assert shown(kept) == (FIGURES[name], TABLES[name])
