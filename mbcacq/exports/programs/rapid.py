"""RAPID (.mod, .modx, .prg, .sys): jointtargets that MoveAbsJ goes to."""

from __future__ import annotations

import re
from typing import Any

from mbcacq.errors import ConfigError
from mbcacq.exports.programs.program import DEGREES, LineNumbers, RobotProgram, Statements, kind

# A comment to the end of its line, a string, what ends a statement, and all else: a text is cut into statements by these.
_PIECES = re.compile(r'![^\r\n]*|"(?:[^"\r\n]|"")*"?|;|[^!";]+')
AXES = 6


class _RapidStatements(Statements):
    grammar, doubtful = "rapid.lark", re.compile(r"jointtarget|MoveAbsJ", re.IGNORECASE)

    def __init__(self) -> None:
        super().__init__(AXES)
        self.moves = False
        self.jointtargets = set[str]()  # names declared as such

    def reason(self, variable: str) -> str:
        uses = self.uses[variable]
        if not self.moves and not uses.otherwise:
            uses.absolute.append(0)  # a module of data alone: a jointtarget is a target by its type
        return uses.reason(variable)

    def statement(self, begin: int, code: str, line_of: LineNumbers) -> None:
        pieces = self.parsed(code, line_of(begin + len(code) - len(code.lstrip())), "statement")
        names = [str(child).lower() for child in pieces if kind(child) == "NAME"]
        if "jointtarget" in names:
            self.jointtargets |= set(names[names.index("jointtarget") + 1 :])
        types = {"jointtarget", "robtarget"} & set(names)
        for child in pieces:
            if "jointtarget" in types and kind(child) == "NAME":
                continue  # a declaration says what there is and uses nothing
            if kind(child) == "motion":
                self._motion(child, begin, line_of)
            elif kind(child) == "assignment":
                self._assignment(child, types, begin, line_of)
            else:
                self._other(child, begin, line_of)

    def _assignment(self, assignment: Any, types: set[str], begin: int, line_of: LineNumbers) -> None:
        name, value = assignment.children
        number, label = line_of(begin + name.start_pos), str(name)
        if "jointtarget" in types:
            self.jointtargets.add(label.lower())
        if kind(value) == "list" and ("jointtarget" in types or label.lower() in self.jointtargets):
            self._jointtarget(label.lower(), label, value, begin, number)
        elif kind(value) == "list" and "robtarget" in types:
            self.left.append((label, number, "is a pose, whose joints the controller's own kinematics finds"))
        else:
            self.uses[label.lower().split(".")[0]].otherwise.append(number)
            self._other(value, begin, line_of)

    def _motion(self, motion: Any, begin: int, line_of: LineNumbers) -> None:
        word = str(motion.children[0]).lower()
        groups = [g for g in motion.children[1:] if not (g.children and str(g.children[0]) == "\\")]  # \Conc and its like come first
        number = line_of(begin + motion.children[0].start_pos)
        to_joints = word.startswith("moveabsj")  # MoveAbsJDO, MoveAbsJSync and others of this kind begin as MoveAbsJ does
        self.moves = self.moves or to_joints
        for count, group in enumerate(groups):
            first = group.children[0] if group.children else None
            alone = len(group.children) == 1 or len(group.children) > 1 and str(group.children[1]) == "\\"
            if to_joints and count == 0 and alone and kind(first) == "NAME":
                self.uses[str(first).lower()].absolute.append(number)
            elif to_joints and count == 0 and alone and kind(first) == "list":
                self._jointtarget("", f"line {number}", first, begin, number)
            elif kind(first) == "list" and count == 0 and word == "moveextj":
                self.left.append((f"line {number}", number, "moves external axes alone"))
            elif kind(first) == "list" and count == 0 and not to_joints:
                self.left.append((f"line {number}", number, "is a pose, whose joints the controller's own kinematics finds"))
            else:
                for part in group.children:
                    self._other(part, begin, line_of)

    def _other(self, part: Any, begin: int, line_of: LineNumbers) -> None:
        stack = [part]
        while stack:
            here = stack.pop()
            if kind(here) == "list" and _looks_like_joints(here):
                number = line_of(begin + next(token.start_pos for token in here.scan_values(lambda _: True)))
                self.left.append((f"line {number}", number, "is no target of a motion"))
            elif hasattr(here, "children"):
                stack += here.children
            elif kind(here) == "NAME":
                self.uses[str(here).lower().split(".")[0]].otherwise.append(line_of(begin + here.start_pos))

    def _jointtarget(self, variable: str, name: str, value: Any, begin: int, number: int) -> None:
        axes = value.children[0].children if value.children else []
        inner = axes[0] if len(axes) == 1 and kind(axes[0]) == "list" else None
        if inner is None or len(inner.children) != AXES:
            self.left.append((name, number, "is no jointtarget of six axes"))
            return
        tokens = [e.children[0] for e in inner.children if len(e.children) == 1 and kind(e.children[0]) == "SIGNED"]
        if len(tokens) != AXES:
            self.left.append((name, number, "has angles that are computed"))
            return
        self.point(variable, name, number, begin, [(token, DEGREES) for token in tokens])


def _looks_like_joints(brackets: Any) -> bool:
    """Whether a list has the form of a jointtarget: six numbers of the arm, six of external axes."""
    parts = [element.children[0] for element in brackets.children if len(element.children) == 1]
    return len(brackets.children) == len(parts) == 2 and all(kind(p) == "list" and len(p.children) == AXES for p in parts)


def read(text: str, n: int) -> RobotProgram:
    """The points of a module for an arm of six axes. Raises ConfigError for another arm."""
    if n != AXES:
        raise ConfigError(f"a jointtarget of RAPID has six axes, this arm has {n}; give the module of an arm of six")
    found, line_of = _RapidStatements(), LineNumbers(text)
    begin, parts = 0, list[str]()
    for match in _PIECES.finditer(text):
        piece = match[0]
        if piece == ";":
            found.statement(begin, "".join(parts), line_of)
            begin, parts = match.end(), []
        else:
            parts.append(" " * len(piece) if piece.startswith("!") else piece)
    note = "no MoveAbsJ stands in this module: its jointtargets are taken for targets by their type"
    return found.program(text, () if found.moves else (note,))
