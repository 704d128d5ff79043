"""Every command of a benchmark that a page names is there, and so is what a benchmark imports of the library."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from doc_pages import ROOT, Page, pages

NAMED = re.compile(r"\bpython benchmarks/([a-z_]+\.py)(?: ([a-z][a-z0-9-]*))?")
COMMAND = re.compile(r'^ +"([a-z0-9-]+)": \(', re.MULTILINE)
EVERY = [*pages(), Page(ROOT / "CONTRIBUTING.md"), *(Page(p) for p in sorted((ROOT / "benchmarks").glob("*.md")))]


def commands(script: Path) -> set[str]:
    """Those that a script gives to ``bench.main``; of another script none, not even an empty one."""
    text = script.read_text(encoding="utf-8")
    return set(COMMAND.findall(text[text.index('if __name__ == "__main__":') :])) if "bench.main(" in text else set()


@pytest.mark.parametrize("page", [page for page in EVERY if NAMED.search(page.text)], ids=lambda page: page.name)
def test_the_benchmark_that_a_page_names_exists(page: Page):
    for name, command in NAMED.findall(page.text):
        script = ROOT / "benchmarks" / name
        assert script.is_file(), name
        if known := commands(script):
            assert command in known, f"{name} {command}"


@pytest.mark.parametrize("script", sorted((ROOT / "benchmarks").rglob("*.py")), ids=lambda script: script.stem)
def test_what_a_benchmark_imports_of_the_library_is_there(script: Path):
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mbcacq"):
            for name in (alias.name for alias in node.names):
                assert hasattr(import_module(node.module), name) or find_spec(f"{node.module}.{name}"), f"{node.module} has no {name}"
