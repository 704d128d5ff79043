"""Writes the tutorials that are made of Python blocks as notebooks, ``examples/notebooks/``, and executes them there.

``python docs/_make/notebooks.py [NAME ..]`` from the root of the checkout. A test compares the cells of the notebooks with what this makes,
and executes them again.
"""

from __future__ import annotations

import base64
import json
import os
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
from nbclient import NotebookClient

from mbcacq.figure import MIME, Figure
from mbcacq.report.charts.static_svg import static_svg

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "notebooks"
TUTORIALS = {"csv-to-diagnosis": "library.md", "plan-for-your-arm": "plan-for-your-arm.md", "add-an-effect": "add-an-effect.md"}
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?!https?:)([^)]+)\)")
FIRST = """import os
import tempfile

os.chdir(tempfile.mkdtemp())  # the files of this notebook
"""
WIDTH_PX = 760.0  # of a drawing


def notebook(page: Path) -> dict[str, Any]:
    """The page as a notebook: its Python blocks are cells, the text between them is Markdown."""
    parts = BLOCK.split(page.read_text(encoding="utf-8"))  # text, code, text, ...
    cells = [_cell("code", FIRST)]
    for number, part in enumerate(parts):
        if part.strip():
            text = part.strip("\n") if number % 2 else LINK.sub(_from_notebooks, part.strip())
            cells.append(_cell("code" if number % 2 else "markdown", text))
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": cells, "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}}, "nbformat": 4, "nbformat_minor": 5}


def _cell(kind: str, text: str) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "metadata": {}, "source": text.splitlines(keepends=True)}
    return cell | {"execution_count": None, "outputs": []} if kind == "code" else cell


def _from_notebooks(link: re.Match[str]) -> str:
    """A link of a page in docs/tutorials, as it reads in examples/notebooks."""
    return f"](../../docs/{link[1].removeprefix('../')})" if link[1].startswith("../") else f"](../../docs/tutorials/{link[1]})"


def executed(name: str, timeout_s: float | None = None) -> dict[str, Any]:
    """The notebook of that name with the outputs of its cells, each figure also as a drawing that needs no script.

    Raises nbclient.exceptions.CellExecutionError where a cell fails.
    """
    content = nbformat.reads(json.dumps(notebook(ROOT / "docs" / "tutorials" / TUTORIALS[name])), as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(content, timeout=timeout_s, resources={"metadata": {"path": folder}}, record_timing=False).execute()
    for cell in content["cells"]:
        for output in cell.get("outputs", ()):
            if MIME in (data := output.get("data", {})):
                drawn = _plain(data.pop(MIME))
                data["image/svg+xml"] = static_svg(Figure(drawn["data"], drawn["layout"]), WIDTH_PX)
                data.pop("text/html", None)
    content["metadata"] = notebook(ROOT / "docs" / "tutorials" / TUTORIALS[name])["metadata"]
    return content


def _plain(value: Any) -> Any:
    """What a figure sends to a notebook, its packed arrays as arrays."""
    if isinstance(value, dict) and "bdata" in value:
        array = np.frombuffer(base64.b64decode(value["bdata"]), value["dtype"])
        return array.reshape([int(n) for n in value["shape"].split(",")]) if "shape" in value else array
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list) else value


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or TUTORIALS:
        start, busy = time.monotonic(), os.times()
        (FOLDER / f"{name}.ipynb").write_text(json.dumps(executed(name), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        took = os.times().children_user + os.times().children_system - busy.children_user - busy.children_system
        print(f"{FOLDER / name}.ipynb: {time.monotonic() - start:.0f} s, {took:.0f} s of processor time")


if __name__ == "__main__":
    main()
