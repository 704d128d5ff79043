"""A text line that a pattern matches, with given values in its named groups; for the fake serial sensor."""

from __future__ import annotations

import re
from collections.abc import Mapping

_GROUP = re.compile(r"\(\?P<(\w+)>(?:[^()\\]|\\.)*\)")


def template(pattern: str) -> str:
    """A str.format template. Raises ValueError where the pattern is more than literal text around simple named groups."""
    names = [m[1] for m in _GROUP.finditer(pattern)]
    text = _GROUP.sub("\0", pattern)
    text = re.sub(r"\\s[*+]?", " ", text)
    text = re.sub(r"\\([^\w])", r"\1", text).replace("{", "{{").replace("}", "}}")
    for name in names:
        text = text.replace("\0", "{" + name + "}", 1)
    if not names or re.fullmatch(pattern, fill(text, dict.fromkeys(names, 20.5))) is None:
        raise ValueError(f"no line can be made for '{pattern}'")
    return text


def fill(line: str, values: Mapping[str, float]) -> str:
    return line.format(**{name: f"{value:.2f}" for name, value in values.items()})
