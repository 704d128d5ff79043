"""The notebook-style tutorial is executed block by block, as a reader would paste it."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
ENDING = """
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


def test_tutorial_runs_and_finds_the_scale_of_the_scanner(tmp_path):
    shutil.copytree(ROOT / "plans", tmp_path / "plans")
    blocks = BLOCK.findall((ROOT / "docs" / "tutorials" / "library.md").read_text(encoding="utf-8"))
    (tmp_path / "tutorial.py").write_text("\n".join([*blocks, ENDING]), encoding="utf-8")
    done = subprocess.run([sys.executable, "tutorial.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for picture in ("spacing.html", "residuals.html", "evidence.html"):
        assert "Plotly.newPlot" in (tmp_path / picture).read_text(encoding="utf-8")
