"""Comments in exported files that say that the data are simulated, or that nothing was verified."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from mbcacq.calibration.result_io import effects_of, with_warnings
from mbcacq.exports.mjcf import expressed_effects
from mbcacq.exports.mount import remark

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
    return [*(["simulated: true"] if result.get("simulated") else []), *with_warnings(result), *remark(result), *geometry_alone(result)]


def mjcf_comments(result: Mapping[str, Any]) -> list[str]:
    """The lines for a MuJoCo model of a result, which can hold some of its effects."""
    effects = effects_of(result)
    lines = [line for line in comments(result) if line not in geometry_alone(result)]
    left = expressed_effects(effects).left if effects else []
    return [*lines, *([f"without {', '.join(dict.fromkeys(left))}, which bodies and hinges cannot express"] if left else [])]


def geometry_alone(result: Mapping[str, Any]) -> list[str]:
    """One sentence on the effects that a description of the geometry cannot express; none where the result has no effects."""
    effects = effects_of(result)
    if not effects:
        return []
    names = ", ".join(dict.fromkeys(f"{t.name} at {'+'.join(t.where)}" for t in effects.terms))
    return [f"geometry alone: this format cannot express {names}; mbcacq correct and mbcacq apply take these effects into account"]


def with_comments(name: str, content: str, lines: list[str]) -> str:
    """The text of a file with the lines as comments in front, behind a '#!' line; unchanged where its format has none, or it is empty."""
    sign = COMMENT.get(name) or COMMENT.get(PurePath(name).suffix)
    if sign is None or not content:
        return content
    end = "\r\n" if "\r\n" in content else "\n"
    first, rest = content.split(end, 1) if content.startswith("#!") else ("", content)
    return (first + end if first else "") + "".join(f"{sign} {line}{end}" for line in lines) + rest
