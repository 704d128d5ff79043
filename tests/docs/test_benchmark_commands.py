"""Every command of a benchmark that a page names is there."""

from __future__ import annotations

import re
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
