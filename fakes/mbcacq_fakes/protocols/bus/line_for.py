"""A text line that a pattern matches, with given values in its named groups; for fake serial devices."""

from __future__ import annotations

import re
import string
from collections.abc import Mapping

_GROUP = re.compile(r"\(\?P<(\w+)>(?:[^()\\]|\\.)*\)")
_FORMATS = (".2f", ".0f", "+.2f", "+.0f", "07.2f", "05.0f")
_TRIAL = 20.5


def template(pattern: str) -> str:
    """A str.format template of the numbers by name. Raises ValueError if the pattern is more than literal text around simple named
    groups."""
    found = [m[1] for m in _GROUP.finditer(pattern)]
    text = _GROUP.sub("\0", pattern)
    text = re.sub(r"\.[*+]", "", text)
    text = re.sub(r"\\s[*+]?", " ", text)
    text = re.sub(r"\\([^\w])", r"\1", text).replace("{", "{{").replace("}", "}}")
    for form in _FORMATS:
        line = text
        for name in found:
            line = line.replace("\0", f"{{{name}:{form}}}", 1)
        if re.fullmatch(pattern, fill(line, dict.fromkeys(found, _TRIAL))):
            return line
    raise ValueError(f"no line can be made for '{pattern}'")


def names(line: str) -> list[str]:
    """What a template wants filled in."""
    return [name for _, name, _, _ in string.Formatter().parse(line) if name]


def fill(line: str, values: Mapping[str, float]) -> str:
    return line.format(**values)
