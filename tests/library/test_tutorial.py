"""The notebook-style tutorials are executed block by block, as a reader would paste them, and are the notebooks."""

import shutil
import subprocess
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
assert copy.pictures() == drawn and copy.to_dict() == found.to_dict() and copy.text == found.text
assert "scanner_scale" in found.write_html("diagnosis.html").read_text(encoding="utf-8")
assert mbcacq.DiagnosisResult.from_json(found.to_json()).to_dict() == found.to_dict()
"""


UNCERTAINTY_FALLS = """
assert data.n_poses >= 12
assert sigma[-1] < sigma[0]
assert "Plotly.newPlot" in Path("poses.html").read_text(encoding="utf-8")
"""
HOSE_IS_FOUND = """
assert {effect.name for effect in before.effects} <= {"unknown"}
assert "A1" in {place for effect in before.effects for place in effect.where}
(hose,) = after.effects
assert hose.name == "hose_pull" and hose.where == ("A1",)
assert abs(hose.parameters["A1.pull_rad"].value - 4e-4) < 4 * hose.parameters["A1.pull_rad"].std
"""
ENDINGS = {"csv-to-diagnosis": SCALE_IS_FOUND, "plan-for-your-arm": UNCERTAINTY_FALLS, "add-an-effect": HOSE_IS_FOUND}


@pytest.mark.parametrize("name", notebooks.TUTORIALS)
def test_a_tutorial_runs_and_finds_what_it_promises(name, tmp_path):
    shutil.copytree(ROOT / "plans", tmp_path / "plans")
    blocks = notebooks.BLOCK.findall((ROOT / "docs" / "tutorials" / notebooks.TUTORIALS[name]).read_text(encoding="utf-8"))
    (tmp_path / "tutorial.py").write_text("\n".join([*blocks, ENDINGS[name]]), encoding="utf-8")
    done = subprocess.run([sys.executable, "tutorial.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    if name == "csv-to-diagnosis":
        for picture in ("spacing.html", "residuals.html", "evidence.html"):
            assert "Plotly.newPlot" in (tmp_path / picture).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", notebooks.TUTORIALS)
def test_the_notebook_is_the_tutorial(name):
    assert (notebooks.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8") == notebooks.text_of(name), "run python docs/_make/notebooks.py"
