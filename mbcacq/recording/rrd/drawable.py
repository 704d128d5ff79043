"""Text that the viewer can draw. It ends with an error where one character of a shown text is in none of its fonts (rerun 0.41)."""

from __future__ import annotations

import re

import rerun as rr

# Blocks that both of its fonts have, Inter and JetBrains Mono; within them the characters that one of them lacks are left out.
_BLOCKS = (
    "\n\n\t\t ~\u00a0\u00ac\u00ae\u0148\u014a\u017f\u0384\u038a\u038c\u038c\u038e\u03a1\u03a3\u03ce"
    "\u0401\u040c\u040e\u044f\u0451\u045c\u045e\u045f\u0490\u0493\u1ea0\u1ef9\u2013\u2014\u2018\u2022\u2026\u2026\u2030\u2030\u2039\u203a\u2070\u2070\u2074\u207a\u2080\u2089\u20ac\u20ac"
    "\u2116\u2116\u2122\u2122\u2190\u2199\u2202\u2202\u2206\u2206\u2211\u2212\u221a\u221a\u221e\u221e\u2248\u2248\u2260\u2260\u2264\u2265\u2713\u2713\u2717\u2717"
)
_DRAWN = frozenset(chr(c) for a, b in zip(_BLOCKS[::2], _BLOCKS[1::2], strict=True) for c in range(ord(a), ord(b) + 1))
REPLACEMENT = "?"
# A raised minus is in neither font: a negative power is written on the line.
_NEGATIVE_POWER = re.compile("⁻[⁰¹²³⁴-⁹]+")
_LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def drawable(text: str) -> str:
    """The text with a question mark for each character that the viewer has no shape for; negative powers as 10^-6."""
    text = _NEGATIVE_POWER.sub(lambda power: f"^{power[0].translate(_LOWERED)}", text)
    return "".join(c if c in _DRAWN else REPLACEMENT for c in text)


def drawn_text(text: str, markdown: bool = True) -> rr.TextDocument:
    """A text to be shown, not to be read back."""
    return rr.TextDocument(drawable(text), media_type=rr.MediaType.MARKDOWN if markdown else rr.MediaType.TEXT)
