"""FANUC LS (.ls): positions in joint form that motion instructions go to without INC and without an offset.

The teach pendant counts J3 from the horizontal. The angle between the links of axes 2 and 3 is J2 + J3, and that is the joint angle of a
description by rows (as of the maker's own for ROS).
"""

from __future__ import annotations

import re
from collections import defaultdict
from typing import Any

import numpy as np
from lark.exceptions import LarkError, UnexpectedInput

from mbcacq.errors import ConfigError
from mbcacq.exports.programs.program import DEGREES, LeftAlone, LineNumbers, ProgrammedPoint, RobotProgram, Uses, kind, parser_of
from mbcacq.quantities import from_degrees

MOTIONS = ("J", "L", "C", "A", "S")
MOVED = re.compile(r"offset|^lock|^pallet", re.IGNORECASE)
_SECTION = re.compile(r"^/(MN|POS|END|PROG|ATTR|APPL)\b.*$", re.MULTILINE)
_REMARK = re.compile(r"\s*(\d+\s*)?:\s*(!|//)")


def read(text: str, n: int) -> RobotProgram:
    """The points of a program for an arm of n axes. Raises ConfigError with the line for positions that are not understood."""
    sections = {match[1]: match for match in _SECTION.finditer(text)}
    if "POS" not in sections:
        raise ConfigError("has no section /POS, in which an LS program holds its positions; save the program as ASCII (.ls)")
    begin = sections["POS"].end()
    end = sections["END"].start() if "END" in sections and sections["END"].start() > begin else len(text)
    line_of = LineNumbers(text)
    try:
        tree = parser_of("fanuc_positions.lark").parse(text[begin:end])
    except UnexpectedInput as error:
        place = begin + max(int(error.pos_in_stream or 0), 0)
        raise ConfigError(f"line {line_of(place)}: these positions are not understood; save the program as ASCII (.ls) anew") from None
    uses = _uses(text, sections["MN"].end(), begin, line_of) if "MN" in sections else defaultdict(Uses)
    points: list[ProgrammedPoint] = []
    left: list[LeftAlone] = []
    for position in tree.children:
        _position(position, n, begin, line_of, uses, points, left)
    coupling = np.eye(n)
    if n == 6:
        coupling[2, 1] = 1.0
    notes = ("J3 of the program is counted from the horizontal: the arm's third angle is J2 + J3",) if points and n == 6 else ()
    return RobotProgram(text, tuple(points), tuple(left), coupling if n == 6 else None, notes)


def _position(
    position: Any, n: int, begin: int, line_of: LineNumbers, uses: dict[str, Uses], points: list[ProgrammedPoint], left: list[LeftAlone]
) -> None:
    key = str(int(position.children[0]))
    line = line_of(begin + position.children[0].start_pos)
    labels = [str(c).strip("'\"") for c in position.children[1:] if kind(c) == "STRING"]
    name = f"P[{key}{':' + labels[0] if labels else ''}]"
    groups = [g for g in position.children if kind(g) == "group" and str(g.children[0]) == "GP1"]
    fields = {str(f.children[0]).upper(): f.children[1] for g in groups for f in g.children[1:]}
    values = [fields.get(f"J{i + 1}") for i in range(n)]
    if any(value is None for value in values):
        cartesian = {"X", "Y", "Z", "W", "P", "R"} <= set(fields)
        left.append((name, line, "is a pose, whose joints the controller's own kinematics finds" if cartesian else f"has not {n} axes"))
        return
    parts = [[str(c) for c in value.children] for value in values if value is not None]
    if any(len(p) < 2 or p[0].startswith("*") or p[1].lower() != "deg" for p in parts):
        left.append((name, line, "is not taught, or has axes in mm"))
        return
    reason = uses[key].reason("p")
    if reason:
        left.append((name, line, reason))
        return
    tokens = [value.children[0] for value in values if value is not None]
    spans = tuple((begin + t.start_pos, begin + t.end_pos) for t in tokens)
    points.append(ProgrammedPoint(name, line, from_degrees([float(t) for t in tokens]), spans, (DEGREES,) * n))


def _uses(text: str, begin: int, end: int, line_of: LineNumbers) -> dict[str, Uses]:
    """What the statements between two places do with each position."""
    out: dict[str, Uses] = defaultdict(Uses)
    everything = Uses()  # of positions whose number is in a register
    at = begin
    for statement in text[begin:end].split(";"):
        number, at = line_of(at + len(statement) - len(statement.lstrip())), at + len(statement) + 1
        if _REMARK.match(statement):
            continue
        try:
            tree = parser_of("fanuc_statement.lark").parse(statement)
        except LarkError:
            for key in re.findall(r"\bP\[\s*(\d+)", statement):
                out[str(int(key))].otherwise.append(number)
            continue
        words = [str(c) for c in tree.children if kind(c) == "NAME"]
        motion = bool(words) and (words[0] in MOTIONS or not _numbered(tree))
        relative = any(w.upper().startswith("INC") for w in words)
        moved = any(MOVED.search(w) for w in words)
        for indexed in (t for t in tree.iter_subtrees() if t.data == "indexed" and str(t.children[0]) == "P"):
            first = indexed.children[1] if len(indexed.children) > 1 else None
            numbered = kind(first) == "SIGNED" and str(first).isdecimal()
            uses = out[str(int(str(first)))] if numbered else everything
            target = uses.relative if relative else uses.otherwise if moved or not motion else uses.absolute
            target.append(number)
    for uses in out.values():
        uses.add(everything)
    return defaultdict(lambda: everything, out)  # what no statement names by its number may be reached by a register


def _numbered(tree: Any) -> bool:
    """Whether the statement begins with the number of its line; the end point of a circle does not."""
    return bool(tree.children) and kind(tree.children[0]) == "SIGNED"
