"""KRL expressions to Python expressions.

KRL ranks NOT, then * /, + -, AND, EXOR, OR, and comparisons last of all: Python ranks ~, * /, + -, &, ^, | and comparisons alike. So a text
whose words are replaced is read by Python's own parser, and the operators get KRL's meaning after that.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable

from mbcacq_fakes.protocols.krc.krl.values import KrlError

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<text>"[^"]*") | (?P<enum>\#\w+) | (?P<number>\d+\.\d*(?:[eE][-+]?\d+)?|\.\d+|\d+) | (?P<system>\$\w+) | (?P<name>[A-Za-z_]\w*)
    | (?P<whole>\[\s*\])  # name[]: the text itself
     | (?P<op><>|==|<=|>=|[-+*/()\[\],.{}<>])
)""",
    re.X,
)
_WORDS = {"NOT": "~", "AND": "&", "EXOR": "^", "OR": "|", "TRUE": "True", "FALSE": "False"}
_BRACKETS = {"(": ("(", ")"), "[": ("[", "]"), "{": ("V.Struct(", "))")}
_MEANING: dict[type[ast.AST], str] = {
    ast.Eq: "V.equal({}, {})",
    ast.NotEq: "not V.equal({}, {})",
    ast.BitOr: "V.either({}, {})",
    ast.BitXor: "V.differ({}, {})",
    ast.BitAnd: "V.both({}, {})",
    ast.Div: "V.divide({}, {})",
    ast.Invert: "V.negate({})",
}


def expression(text: str, name: Callable[[str, bool], str]) -> str:
    """The Python text of an expression, or of something that can be assigned to. name(identifier, is_call): the Python text for an
    identifier. Raises KrlError."""
    try:
        return ast.unparse(_Meaning().visit(ast.parse(_in_python(text, name), mode="eval")))
    except SyntaxError as error:
        raise KrlError(f"'{text.strip()}' is no expression ({error.msg})") from error


def _in_python(text: str, name: Callable[[str, bool], str]) -> str:
    out, position, text = list[str](), 0, text.strip()
    before, closers = "", list[str]()  # what closes each bracket that is open
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise KrlError(f"cannot read '{text[position:]}'")
        kind, word, position = match.lastgroup, match[match.lastgroup or 0], match.end()
        of_structure = closers[-1:] == ["))"] and before in ("{", ",")
        if kind == "name" and before != "." and word.upper() in _WORDS:
            out.append(_WORDS[word.upper()])
        elif kind == "name":
            calls = text[position:].lstrip().startswith("(")
            out.append(f"{word.lower()}=float(" if of_structure else word.lower() if before == "." else name(word, calls))
        elif word in _BRACKETS:
            out.append(_BRACKETS[word][0])
            closers.append(_BRACKETS[word][1])
        elif word in ")]}":
            out.append(closers.pop() if closers else ")")
        else:
            out.append(")," if word == "," and closers[-1:] == ["))"] else _plain(kind, word))
        before = word
    return " ".join(out)


def _plain(kind: str | None, word: str) -> str:
    return {"whole": "", "enum": f"'{word.upper()}'", "system": f"S.{word[1:].lower()}"}.get(kind or "", "!=" if word == "<>" else word)


class _Meaning(ast.NodeTransformer):
    """Operators as calls of ``values``; a call of a program waits for what that yields."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:  # noqa: N802 -- as ast names it
        return self._meant(node, node.op, node.left, node.right)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:  # noqa: N802
        return self._meant(node, node.op, node.operand)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:  # noqa: N802
        return self._meant(node, node.ops[0], node.left, node.comparators[0])

    def visit_Call(self, node: ast.Call) -> ast.AST:  # noqa: N802
        self.generic_visit(node)
        if not isinstance(node.func, ast.Subscript):
            return node
        node.args.insert(0, ast.Name("P"))
        return ast.YieldFrom(node)

    def _meant(self, node: ast.AST, operator: ast.AST, *operands: ast.AST) -> ast.AST:
        if (form := _MEANING.get(type(operator))) is None:
            return self.generic_visit(node)
        return ast.parse(form.format(*(ast.unparse(self.visit(one)) for one in operands)), mode="eval").body
