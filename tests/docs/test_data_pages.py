"""The pages of docs/data show the words in which today's program says what was found in the recordings."""

from __future__ import annotations

import sys

import pytest
from doc_pages import ROOT

sys.path.insert(0, str(ROOT / "docs" / "_make"))

from data_pages import BLOCK, DATA, refreshed  # noqa: E402

PAGES = [page for page in sorted(DATA.glob("*.md")) if BLOCK.search(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_shows_is_printed(page):
    text = page.read_text(encoding="utf-8")
    assert refreshed(text) == text, "run python docs/_make/data_pages.py"


def test_every_diagnosis_that_is_kept_is_shown():
    shown = {found[1] for page in PAGES for found in BLOCK.findall(page.read_text(encoding="utf-8"))}
    assert shown == {file.name.removesuffix(".words.json") for file in DATA.glob("*.words.json")}
    assert len(shown) >= 5
