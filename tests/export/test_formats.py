"""Formats of results: those of other packages are found by one line, and chosen by their names."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_folder import run

from mbcacq.errors import ConfigError
from mbcacq.exports.format import ExportFormat, formats

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "add-an-export.md"
OF_KUKA = "from mbcacq.exports.format import ExportFormat\nclass Wrong(ExportFormat):\n    name = 'wrong'\n    def files(self, exported): return {'NAME': 'x'}\n"


def install(folder, monkeypatch, name, module, target):
    """What ``pip install`` leaves of a package with one module and one line of entry point."""
    (folder / f"{name}_export.py").write_text(module, encoding="utf-8")
    info = folder / f"{name}-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[mbcacq.exports]\n{name} = {target}\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(folder))


def test_the_format_of_the_page_is_written_alone_and_with_the_others(solved, result_file, tmp_path, monkeypatch):
    (module,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    (tmp_path / "site").mkdir()
    install(tmp_path / "site", monkeypatch, "acme", module, "acme_export:AcmeTool")

    run(result_file, "--results", tmp_path / "alone", "--only", "acme", "--tool", 3)
    run(result_file, "--results", tmp_path / "all")

    assert [p.name for p in (tmp_path / "alone").iterdir()] == ["acme.tool"]
    assert {"acme.tool", "result.json", "tool_data.txt"} <= {p.name for p in (tmp_path / "all").iterdir()}
    *comments, line = (tmp_path / "alone" / "acme.tool").read_text().splitlines()
    assert all(comment.startswith("! ") for comment in comments)
    tool, *numbers = line.split()[1:]
    T = np.array(solved[0]["T_flange_scanner"])
    assert tool == "3"
    np.testing.assert_allclose(np.array(numbers[:3], float) * 1e3, T[:3, 3], atol=1e-3)
    np.testing.assert_allclose(Rotation.from_quat(np.array(numbers[3:], float)).as_matrix(), T[:3, :3], atol=1e-8)


def test_chosen_formats_are_written_alone(result_file, tmp_path):
    run(result_file, "--results", tmp_path / "out", "--only", "kuka", "--only", "result")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"tool_data.txt", "result.json", "result.schema.json", "hand_eye.json"}


def test_a_name_of_no_format_is_refused_with_the_installed_ones(result_file, tmp_path):
    with pytest.raises(ConfigError, match=re.escape("no format 'abb' to export (installed: csv, kuka, mjcf, result, ros, urdf)")):
        run(result_file, "--results", tmp_path / "out", "--only", "abb")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("module", "target", "sentence"),
    [
        (OF_KUKA.replace("NAME", "tool_data.txt"), "wrong_export:Wrong", "both write tool_data.txt; choose by --only"),
        (OF_KUKA.replace("NAME", "../up"), "wrong_export:Wrong", "'wrong' writes ../up, which is no plain file name"),
        ("class Wrong: pass", "wrong_export:Wrong", "wrong_export:Wrong is no class derived from ExportFormat"),
        ("import nothing_of_that_name", "wrong_export:Wrong", "cannot be imported: No module named 'nothing_of_that_name'"),
    ],
)
def test_a_faulty_format_is_named_and_nothing_is_written(module, target, sentence, result_file, tmp_path, monkeypatch):
    (tmp_path / "site").mkdir()
    install(tmp_path / "site", monkeypatch, "wrong", module, target)
    monkeypatch.delitem(__import__("sys").modules, "wrong_export", raising=False)
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        run(result_file, "--results", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_every_format_that_comes_along_says_what_it_is():
    for one in formats():
        assert isinstance(one, ExportFormat)
        assert one.name
        assert one.summary
