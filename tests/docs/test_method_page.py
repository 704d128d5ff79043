"""The page on the method names the functions of the code in the order of their calls, and the page on the architecture its files."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "mbcacq"
METHOD = (ROOT / "docs" / "explanation" / "method.md").read_text()
ARCHITECTURE = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
PAGES = {"_calibrate": "calibration/calibrate.py", "adjust": "estimation/adjustment.py", "diagnose": "diagnosis/diagnose.py"}


def table_of(function: str) -> list[str]:
    """Functions in the first column of the table below the line that says ``in `function```."""
    rows = METHOD.split(f"in `{function}`")[1].split("|---|---|\n")[1].split("\n\n")[0]
    return [name for row in rows.splitlines() for name in re.findall(r"`(\w+)`", row.split("|")[1])]


def calls(function: str, file: str) -> list[str]:
    """Names that a function calls, first calls only, with those that functions of its own file call in their place."""
    of = {n.name: n for n in ast.parse((PACKAGE / file).read_text()).body if isinstance(n, ast.FunctionDef)}
    found: list[str] = []

    def follow(name: str) -> None:
        called = [n for n in ast.walk(of[name]) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
        for call in sorted(called, key=lambda n: (n.end_lineno, n.end_col_offset)):  # arguments are evaluated before the call
            if call.func.id not in found:
                found.append(call.func.id)
                if call.func.id in of:
                    follow(call.func.id)

    follow(function)
    return found


@pytest.mark.parametrize(("function", "file"), PAGES.items())
def test_functions_are_named_in_the_order_of_their_calls(function, file):
    named = table_of(function)
    assert len(named) > 5
    assert [name for name in calls(function, file) if name in named] == named


@pytest.mark.parametrize("file", ["calibration/calibrate.py", "diagnosis/diagnose.py"])
def test_a_page_of_the_method_is_a_page(file):
    assert len((PACKAGE / file).read_text().splitlines()) < 200


def test_files_and_classes_that_the_architecture_names_are_there():
    files = set(re.findall(r"`([a-z_/]+\.py)`", ARCHITECTURE))
    assert len(files) > 10
    assert [file for file in files if not (PACKAGE / file).exists() and not (ROOT / file).exists()] == []
    defined = {
        n.name
        for file in files
        if (PACKAGE / file).exists()
        for n in ast.parse((PACKAGE / file).read_text()).body
        if isinstance(n, ast.ClassDef)
    }
    nouns = {name for row in re.findall(r"^\| [A-Z]\w+ \| (.*?) \|", ARCHITECTURE, re.M) for name in re.findall(r"`(\w+)`", row)}
    assert len(nouns) >= 8
    assert nouns <= defined
