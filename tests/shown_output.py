"""What a page of the documentation shows as printed, held against what was printed."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_make"))

from printed import BY_TEST, faults  # noqa: E402


def not_printed(page: str, test: str, printed: str) -> list[str]:
    """The lines that a page shows as printed by a test, and that were not. page, test: from the root of the checkout."""
    text = (ROOT / page).read_text(encoding="utf-8")
    assert any(by == test for by, _ in BY_TEST.findall(text)), f"{page} shows nothing that {test} prints"
    return faults(text, printed, test)
