"""URScript (.script): lists of joint angles that movej and its like go to, in rad, also as d2r(..)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from mbcacq.exports.programs.program import DEGREES, RobotProgram, Statements, kind, lines, names_in

# Whose first arguments are places, joint angles or poses.
MOVES = tuple("movej movel movep movec optimovej optimovel servoj servop servoc".split())
PLACES = {"movec": 2, "servoc": 2}  # a via point and an end
HINTS = ("get_inverse_kin", "get_inverse_kin_has_solution")  # joint angles there are where the search begins
SPEEDS = ("speedj", "speedl", "stopj", "stopl")
POSE_REASON = "is a pose, whose joints the controller's own kinematics finds"
LONGEST_STATEMENT = 200  # lines
# A comment, a string, a bracket: what says whether a statement goes on in the next line.
_PIECES = re.compile(r"""#.*|"[^"]*"?|'[^']*'?|[(\[]|[)\]]""")
_COMMENT = re.compile(r"""#.*|"[^"]*"?|'[^']*'?""")


class _UrStatements(Statements):
    grammar, comment, doubtful = "urscript.lark", "#", re.compile(r"\[")

    def line(self, number: int, at: int, code: str) -> None:
        for child in self.parsed(code, number):
            if kind(child) == "assignment":
                self._assignment(child, number, at)
            else:
                self._part(child, number, at)

    def _assignment(self, assignment: Any, number: int, at: int) -> None:
        children = [c for c in assignment.children if kind(c) != "SCOPE"]
        name, value = str(children[0]), children[1:]
        if len(value) == 1 and kind(value[0]) in ("list", "pose"):
            self._coordinates(name.lower(), name, "", value[0], number, at)
            return
        if value and kind(value[0]) == "call" and len(value) == 1:
            self._part(value[0], number, at)
        else:
            for part in value:
                self._part(part, number, at)

    def _part(self, part: Any, number: int, at: int) -> None:
        """A piece of a statement. An argument of a motion is a target, all else is not."""
        stack = [part]
        while stack:
            here = stack.pop()
            if kind(here) == "call":
                stack += self._call(here, number, at)
            elif kind(here) in ("list", "pose"):
                self._coordinates("", f"line {number}", "is no target of a motion", here, number, at)
            elif hasattr(here, "children"):
                stack += here.children
            elif kind(here) == "NAME":
                self.uses[str(here).lower()].otherwise.append(number)

    def _call(self, call: Any, number: int, at: int) -> list[Any]:
        """The pieces of a call that are still to be looked at."""
        word = str(call.children[0]).lower()
        if word in MOVES:
            return self._motion(call, number, at)
        if word in HINTS:
            self._pose_of(call, number)
            return []
        items = [item for argument in call.children[1:] for item in argument.children]
        speeds = [item for item in items if word in SPEEDS and kind(item) == "list"]
        for item in speeds:
            self._coordinates("", f"line {number}", "is a speed", item, number, at)
        return [item for item in items if item not in speeds]

    def _motion(self, call: Any, number: int, at: int) -> list[Any]:
        """The pieces of a motion that are not its places."""
        word, rest = str(call.children[0]).lower(), []
        for count, argument in enumerate(call.children[1:]):
            items = argument.children
            named = len(items) > 1 and kind(items[0]) == "NAME" and str(items[0]).lower() in ("q", "pose")
            only = items[-1] if len(items) == 1 or (named and len(items) == 2) else None
            if count >= PLACES.get(word, 1) or only is None:
                rest += items[1:] if len(items) > 1 and kind(items[0]) == "NAME" else items
            elif kind(only) in ("list", "pose"):
                self._coordinates("", f"line {number}", "", only, number, at)
            elif kind(only) == "NAME":
                self.uses[str(only).lower()].absolute.append(number)
            else:
                rest.append(only)
        return rest

    def _pose_of(self, call: Any, number: int) -> None:
        """get_inverse_kin: the pose is the target, and its joints are found by the controller's own kinematics."""
        pose = call.children[1] if len(call.children) > 1 else None
        only = pose.children[0] if pose is not None and len(pose.children) == 1 else None
        if kind(only) == "NAME":
            self.uses[str(only).lower()].absolute.append(number)
            return
        for name in names_in(pose):
            self.uses[name].otherwise.append(number)
        self.left.append((f"line {number}", number, POSE_REASON))

    def _coordinates(self, variable: str, name: str, reason: str, brackets: Any, number: int, at: int) -> None:
        for inside in names_in(brackets):  # an element of another target is no target: [home[0], ..]
            self.uses[inside].otherwise.append(number)
        if brackets.data == "pose":
            if len(brackets.children) == 7 and not reason:  # 'p[' itself is one
                self.left.append((name, number, POSE_REASON))
            return
        inner = [e.children[0] for e in brackets.children if len(e.children) == 1 and kind(e.children[0]) == "list"]
        for one in inner:
            self._coordinates("", name, reason or "is part of a list", one, number, at)
        if len(brackets.children) != self.n:
            if not (variable or reason or inner):
                self.left.append((name, number, f"has not {self.n} angles"))
            return
        numbers = [_angle(element) for element in brackets.children]
        if not all(numbers):
            if not variable:
                self.left.append((name, number, reason or "has angles that are computed"))
            return
        if reason:
            self.left.append((name, number, reason))
        else:
            self.point(variable, name, number, at, numbers)


def _angle(element: Any) -> Any:
    """The number of an element and the unit that it has, rad or by d2r() deg; None if it is computed."""
    if len(element.children) != 1:
        return None
    item = element.children[0]
    if kind(item) == "SIGNED":
        return item, 1.0
    if kind(item) == "call" and str(item.children[0]) == "d2r" and len(item.children) == 2:
        inside = item.children[1].children
        if len(inside) == 1 and kind(inside[0]) == "SIGNED":
            return inside[0], DEGREES
    return None


def _statements(text: str) -> Iterator[tuple[int, int, str]]:
    """Lines, those joined whose brackets are open at the end: number of the first, place, and content with comments blanked between."""
    begin, count, depth, parts = 0, 0, 0, list[str]()
    number = 0
    for number_here, at, line in lines(text):
        if not parts:
            number, begin = number_here, at
        gap = at - begin - sum(map(len, parts))
        parts.append(" " * gap + line)
        for piece in _PIECES.findall(line):
            depth += (piece in "([") - (piece in ")]") if len(piece) == 1 else 0
        count += 1
        if depth > 0 and count < LONGEST_STATEMENT:
            parts[-1] = _COMMENT.sub(lambda m: m[0] if m[0][0] != "#" else " " * len(m[0]), parts[-1])
            continue
        yield number, begin, "".join(parts)
        depth, count, parts = 0, 0, []
    if parts:
        yield number, begin, "".join(parts)


def read(text: str, n: int) -> RobotProgram:
    """The points of a program for an arm of n axes."""
    found = _UrStatements(n)
    for number, at, line in _statements(text):
        found.line(number, at, line)
    return found.program(text)
