"""The glossary holds: its terms stand in order, and what they replace stands nowhere."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "glossary.md"
ROWS = [tuple(cell.strip() for cell in line.strip("| \n").split(" | ")) for line in PAGE.read_text().splitlines() if line.startswith("| ")]
ROWS = [row if len(row) == 3 else (*row, "") for row in ROWS[1:]]
REPLACED = [word.strip() for row in ROWS for word in row[2].rstrip("| ").split(",") if word.strip()]
NAMES = [word.strip("`") for word in REPLACED if word.startswith("`")]
PHRASES = [word for word in REPLACED if not word.startswith("`")]
CODE = [p for folder in ("mbcacq", "drivers", "fakes") for p in (ROOT / folder).rglob("*.py")]
PAGES = [p for p in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*.md")) if p != PAGE]


def test_terms_stand_in_order_and_each_has_a_meaning():
    terms = [row[0] for row in ROWS]
    assert terms == sorted(terms, key=lambda t: t.lower().replace("-", ""))
    assert len(set(terms)) == len(terms)
    assert all(len(row[1]) > 10 for row in ROWS)
    assert NAMES
    assert PHRASES


@pytest.mark.parametrize("phrase", PHRASES)
def test_no_text_says_it_otherwise(phrase):
    pattern = re.compile(rf"\b{re.escape(phrase)}s?\b", re.IGNORECASE)
    assert [str(p.relative_to(ROOT)) for p in (*PAGES, *CODE) if pattern.search(p.read_text(encoding="utf-8"))] == []


def test_proof_is_a_word_of_the_rsi_driver_alone():
    """Data, figures and effects show something, with a probability; nobody proves them."""
    word = re.compile(r"\b(?:proofs?|proven|unproven)\b", re.IGNORECASE)
    pages = [p for p in PAGES if p.is_relative_to(ROOT / "docs") or p.name == "README.md"]
    assert [str(p.relative_to(ROOT)) for p in pages if word.search(p.read_text(encoding="utf-8"))] == ["docs/explanation/corrections.md"]


def test_no_name_of_the_code_uses_a_word_that_a_term_replaces():
    found = []
    for path in CODE:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(node, "name", None) or getattr(node, "id", None) or getattr(node, "arg", None)
            if isinstance(name, str) and set(re.findall(r"[a-z]+", name.lower())) & set(NAMES):
                found.append(f"{path.relative_to(ROOT)}: {name}")
    assert found == []
