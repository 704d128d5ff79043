"""Comments in exported files that say that the data are simulated, or that nothing was verified."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from mbcacq.calibration.caveats import caveats

COMMENT = {
    "tool_data.txt": ";",
    ".calib": "#",
    ".yaml": "#",
    ".py": "#",
    ".sh": "#",
    ".diff": "#",
}  # by name or ending; patch passes over such lines


def comments(result: Mapping[str, Any]) -> list[str]:
    """The lines for a result: 'simulated: true' first where it is, then the sentences."""
    return [*(["simulated: true"] if result.get("simulated") else []), *caveats(result)]


def with_comments(name: str, content: str, lines: list[str]) -> str:
    """The text of a file with the lines as comments in front, behind a '#!' line; unchanged where its format has none, or it is empty."""
    sign = COMMENT.get(name) or COMMENT.get(PurePath(name).suffix)
    if sign is None or not content:
        return content
    end = "\r\n" if "\r\n" in content else "\n"
    first, rest = content.split(end, 1) if content.startswith("#!") else ("", content)
    return (first + end if first else "") + "".join(f"{sign} {line}{end}" for line in lines) + rest
