"""KRL expressions to Python expressions. Precedence as in KRL: NOT, then * /, + -, AND, EXOR, OR, and comparisons last of all."""

from __future__ import annotations

import re
from collections.abc import Callable

from mbcacq_fakes.protocols.krc.krl.values import KrlError

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<text>"[^"]*") | (?P<enum>\#\w+) | (?P<number>\d+\.\d*(?:[eE][-+]?\d+)?|\.\d+|\d+) | (?P<system>\$\w+) | (?P<name>[A-Za-z_]\w*)
    | (?P<op><>|==|<=|>=|[-+*/()\[\],.{}<>:])
)""",
    re.X,
)
_COMPARE = {
    "==": "V.equal({}, {})",
    "<>": "not V.equal({}, {})",
    "<": "({} < {})",
    ">": "({} > {})",
    "<=": "({} <= {})",
    ">=": "({} >= {})",
}
_LEVELS = (
    _COMPARE,
    {"OR": "V.either({}, {})"},
    {"EXOR": "V.differ({}, {})"},
    {"AND": "V.both({}, {})"},
    {"+": "({} + {})", "-": "({} - {})"},
    {"*": "({} * {})", "/": "V.divide({}, {})"},
)


def tokens(text: str) -> list[tuple[str, str]]:
    found, position = [], 0
    text = text.rstrip()
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise KrlError(f"cannot read '{text[position:]}'")
        found.append((match.lastgroup or "", match[match.lastgroup or 0]))
        position = match.end()
    return found


class ExpressionReader:
    """One expression or reference. ``name(identifier, is_call)`` gives the Python text for an identifier."""

    def __init__(self, text: str, name: Callable[[str, bool], str]) -> None:
        self._tokens, self._at, self._name = tokens(text), 0, name

    def expression(self) -> str:
        value = self._binary(0)
        self._end()
        return value

    def reference(self) -> str:
        """Something that can be assigned to."""
        value = self._primary()
        self._end()
        return value

    def arguments(self) -> list[str]:
        """A comma separated list, in the parentheses that follow."""
        self._expect("(")
        values = self._list(")")
        self._end()
        return values

    def _list(self, close: str) -> list[str]:
        values: list[str] = []
        while not self._take(close):
            if values:
                self._expect(",")
            values.append(self._binary(0))
        return values

    def _binary(self, level: int) -> str:
        if level == len(_LEVELS):
            return self._unary()
        left, forms = self._binary(level + 1), _LEVELS[level]
        while self._peek()[1].upper() in forms:
            form = forms[self._next()[1].upper()]
            left = form.format(left, self._binary(level + 1))
        return left

    def _unary(self) -> str:
        kind, text = self._peek()
        if kind == "name" and text.upper() == "NOT":
            self._next()
            return f"V.negate({self._unary()})"
        if text == "-":
            self._next()
            return f"(-{self._unary()})"
        return self._primary()

    def _primary(self) -> str:
        kind, text = self._next()
        if kind == "name":
            return self._named(text)
        if kind == "system":
            return self._members(f"S.{text[1:].lower()}")
        if text == "(":
            value = self._binary(0)
            self._expect(")")
            return f"({value})"
        if text == "{":
            return self._aggregate()
        constants = {"text": text, "number": text.rstrip("."), "enum": f"'{text.upper()}'"}
        if kind not in constants:
            raise KrlError(f"'{text}' stands where a value should")
        return constants[kind]

    def _named(self, text: str) -> str:
        if text.upper() in ("TRUE", "FALSE"):
            return text.capitalize()
        if self._take("("):
            return f"(yield from {self._name(text, True)}({', '.join(['P', *self._list(')')])}))"
        return self._members(self._name(text, False))

    def _aggregate(self) -> str:
        parts = []
        while not self._take("}"):
            if parts:
                self._expect(",")
            kind, member = self._next()
            if kind != "name":
                raise KrlError(f"'{member}' is no member of a structure")
            parts.append(f"{member.lower()}=float({self._binary(1)})")
        return f"V.Struct({', '.join(parts)})"

    def _members(self, value: str) -> str:
        while True:
            if self._take("["):
                if not self._take("]"):  # name[]: the text itself
                    value += f"[{self._binary(0)}]"
                    self._expect("]")
            elif self._take("."):
                value += f".{self._next()[1].lower()}"
            else:
                return value

    def _peek(self) -> tuple[str, str]:
        return self._tokens[self._at] if self._at < len(self._tokens) else ("", "")

    def _next(self) -> tuple[str, str]:
        token = self._peek()
        self._at += 1
        if not token[1]:
            raise KrlError("the expression ends too early")
        return token

    def _take(self, text: str) -> bool:
        if self._peek()[1] != text:
            return False
        self._at += 1
        return True

    def _expect(self, text: str) -> None:
        if not self._take(text):
            raise KrlError(f"'{text}' is missing before '{self._peek()[1]}'")

    def _end(self) -> None:
        if self._at != len(self._tokens):
            raise KrlError(f"'{self._peek()[1]}' is one word too many")
