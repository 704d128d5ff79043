"""Writes the tutorials that are made of Python blocks as notebooks, ``examples/notebooks/``.

``python docs/_make/notebooks.py`` from the root of the checkout; a test compares the notebooks with what this makes, another one executes
the blocks.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "notebooks"
TUTORIALS = {"csv-to-diagnosis": "library.md", "plan-for-your-arm": "plan-for-your-arm.md", "add-an-effect": "add-an-effect.md"}
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?!https?:)([^)]+)\)")
FIRST = """import os

while not os.path.isdir("plans"):  # a notebook starts in its own folder; the pages start at the root of the repository
    os.chdir("..")
"""


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


def text_of(name: str) -> str:
    """The notebook of that name as it is written to the disk."""
    return json.dumps(notebook(ROOT / "docs" / "tutorials" / TUTORIALS[name]), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in TUTORIALS:
        (FOLDER / f"{name}.ipynb").write_text(text_of(name), encoding="utf-8")
        print(FOLDER / f"{name}.ipynb")


if __name__ == "__main__":
    main()
