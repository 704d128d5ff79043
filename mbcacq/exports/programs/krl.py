"""KRL (.src, .dat): points are corrected that a PTP or SPTP goes to, or LIN and the like with joint angles; increments never."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from mbcacq.exports.programs.program import DEGREES, LeftAlone, RobotProgram, Statements, kind, lines, names_in

POSE = {"x", "y", "z", "s", "t"}
FRAME = {"x", "y", "z"}  # of a base or a tool too, unless a motion uses it
DECLARING = ("decl", "global", "const")
POSE_REASON = "is a pose, whose joints are the controller's choice"
OTHER = "is no place"
_DATA = re.compile(r"\s*(?:GLOBAL\s+)?DEFDAT\s+[\w$]", re.IGNORECASE)
_MOVES = re.compile(r"\bS?(?:PTP|LIN|CIRC)(?:_REL)?\b", re.IGNORECASE)
_INLINE_FORM = re.compile(r"x", re.IGNORECASE)  # the controller's forms call the coordinates of point P1 XP1


class _KrlStatements(Statements):
    grammar, comment, word = "krl.lark", ";", re.compile(r"[$A-Za-z_][\w$]*")
    doubtful = re.compile(r"\{.*\bA1\s|\bA1\s.*\{", re.IGNORECASE)

    def __init__(self, n: int, text: str) -> None:
        super().__init__(n)
        self.frames: list[tuple[str, str, int]] = []  # variable, name, line
        self.targets: dict[str, int] = {}  # variables that motions go to, and the first line
        self.assigned = set[str]()
        self.by_name = False  # no program says what the points of a data list are for
        for number, at, code in lines(text):
            if not (code.startswith("&") or _DATA.match(code)):
                self._line(number, at, code)

    def reason(self, variable: str) -> str:
        uses = self.uses[variable]
        if self.by_name and not uses.otherwise:
            uses.absolute.append(0)
            return uses.reason(variable) or ("" if _INLINE_FORM.match(variable) else "no known program has a target of this name")
        return uses.reason(variable)

    def _line(self, number: int, at: int, code: str) -> None:
        pieces = self.parsed(code, number)
        declared = bool(pieces) and next(iter(names_in(pieces[0])), "") in DECLARING
        for child in pieces:
            if declared and kind(child) == "variable":
                continue  # a declaration says what there is and uses nothing
            if kind(child) == "motion":
                self._motion(child, number, at)
            elif kind(child) == "assignment":
                self._assignment(child, number, at)
            else:
                self._other(child, number, at)

    def _motion(self, motion: Any, number: int, at: int) -> None:
        word = str(motion.children[0]).upper()
        relative = word.endswith("_REL")
        for group in motion.children[1:]:
            if group.data == "tail":
                for part in group.children:
                    self._other(part, number, at)
                continue
            first, more = group.children[0], group.children[1:]
            approximated = all(str(name).lower().startswith("c_") for part in more for name in names_in(part)) and all(
                kind(part) == "variable" or kind(part) == "ENUM" for part in more
            )  # C_PTP; #BASE and #TOOL of relative motions
            if kind(first) == "aggregate":
                why = "" if approximated else "is part of an expression"
                before = len(self.points) + len(self.left)
                self._coordinates("", f"line {number}", f"is the increment of {word}" if relative else why, first, number, at)
                if len(self.points) + len(self.left) == before:
                    self.left.append((f"line {number}", number, f"is the increment of {word}" if relative else POSE_REASON))
            elif kind(first) == "variable" and approximated:
                name = str(first.children[0]).lower()
                (self.uses[name].relative if relative else self.uses[name].absolute).append(number)
                if not relative:
                    self.targets.setdefault(name, number)
                if len(first.children) > 1 and kind(first.children[1]) != "index":
                    self.uses[name].otherwise.append(number)
            else:
                for part in group.children:
                    self._other(part, number, at)

    def _assignment(self, assignment: Any, number: int, at: int) -> None:
        variable, value = assignment.children
        name = str(variable.children[0])
        self.assigned.add(name.lower())
        for part in variable.children[1:]:
            for inner in names_in(part):
                self.uses[inner].otherwise.append(number)
        whole = len(variable.children) == 1 or (len(variable.children) == 2 and kind(variable.children[1]) == "index")
        if kind(value) == "aggregate" and whole:
            label = "".join(str(t) for t in variable.scan_values(lambda _: True)) if len(variable.children) == 1 else name
            self._coordinates(name.lower(), label, "", value, number, at)
            return
        self.uses[name.lower()].otherwise.append(number)
        self._other(value, number, at)

    def _other(self, part: Any, number: int, at: int) -> None:
        """A piece of a statement that makes nothing of what stands in it a target."""
        for name in names_in(part):
            self.uses[name].otherwise.append(number)
        inside = [part] if not hasattr(part, "iter_subtrees") else [*part.iter_subtrees(), *part.scan_values(lambda t: t.type == "STRING")]
        for piece in inside:
            if kind(piece) == "aggregate":
                self._coordinates("", f"line {number}", "is no target of a motion", piece, number, at)
            elif kind(piece) == "STRING" and re.search(r"\{[^{}]*\bA1\s", str(piece), re.IGNORECASE):
                self.left.append((f"line {number}", number, "is text in a string"))

    def _coordinates(self, variable: str, name: str, reason: str, aggregate: Any, number: int, at: int) -> None:
        fields: dict[str, Any] = {}  # the token of what may be a number
        for f in aggregate.children:
            if f.data != "field":
                continue
            token, value = f.children[0], f.children[-1]
            if token.type == "NUMBERED":
                word, text = str(token).split()
                fields[word.lower()] = token.update(value=text)
                fields[word.lower()].start_pos = token.end_pos - len(text)
            elif kind(value.children[0]) == "aggregate":
                self._coordinates("", name, "is part of a structure", value.children[0], number, at)
            elif len(f.children) == 2:
                fields[str(token).lower()] = value.children[0] if len(value.children) == 1 else None
        wanted = [f"a{i + 1}" for i in range(self.n)]
        if why := _no_joint_target(aggregate, fields, wanted):
            if why != OTHER:
                self.left.append((name, number, reason or why))
            elif variable and set(fields) >= FRAME:
                self.frames.append((variable, name, number))
            return
        found = [fields[key] for key in wanted]
        if not all(kind(token) in ("SIGNED", "NUMBERED") and token[0] != "'" for token in found):
            self.left.append((name, number, reason or "has angles that are computed"))
            return
        self.point(variable, name, number, at, [(token, DEGREES) for token in found], reason)


def _no_joint_target(aggregate: Any, fields: Mapping[str, Any], wanted: Sequence[str]) -> str:
    """Why an aggregate is not the angles of all axes, '' if it is; ``OTHER`` for one that has nothing to do with axes."""
    named = [str(f.children[0]).split()[0].lower() for f in aggregate.children if f.data == "field"]
    if len(set(named)) < len(named) and set(wanted) & set(named):
        return "has the angle of an axis twice"
    if all(key in fields for key in wanted):
        return ""
    if any(re.fullmatch(r"a[1-9]", key) for key in fields):
        return "has not the angles of all axes"
    return POSE_REASON if set(fields) >= POSE else OTHER


def read(text: str, n: int, programs: Iterable[str] = ()) -> RobotProgram:
    """The points of a program for an arm of n axes. programs: texts of those that use a data list (.dat)."""
    found = _KrlStatements(n, text)
    data = any(_DATA.match(line) for _, _, line in lines(text))
    users = [program for program in programs if data]
    for program in users:
        found.uses.add(_KrlStatements(n, program).uses)
    found.by_name = data and not users and not _MOVES.search(text)
    for variable, name, number in found.frames:
        uses = found.uses[variable]
        if uses.relative or uses.absolute:
            found.left.append((name, number, uses.reason(variable) if uses.relative else POSE_REASON))
    found.left += _elsewhere(found)
    note = "no program (.src) stands beside this data list: its points are known by their names, X and the name of the point"
    return found.program(text, (note,) if found.by_name else ())


def _elsewhere(found: _KrlStatements) -> Iterator[LeftAlone]:
    for name, number in found.targets.items():
        if name not in found.assigned and not name.startswith("$"):
            yield name.upper(), number, "has its coordinates in another file, the data list (.dat); correct that one"
