"""Numbers as URDF and xacro write them; xacro's ${...} may hold arithmetic of numbers, pi and radians(). Nothing is executed."""

from __future__ import annotations

import ast
import operator

import numpy as np

from mbcacq.quantities import from_degrees

_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def vector(text: str) -> np.ndarray:
    """Three numbers. Raises ValueError for anything else."""
    parts, depth = [""], 0
    for c in text.strip():
        depth += (c == "{") - (c == "}")
        if c.isspace() and depth == 0:
            parts.append("")
        else:
            parts[-1] += c
    try:
        values = [_value(p) for p in parts if p]
    except (SyntaxError, ZeroDivisionError) as error:
        raise ValueError(text) from error
    if len(values) != 3 or not np.isfinite(values).all():
        raise ValueError(text)
    return np.array(values)


def _value(text: str) -> float:
    if not text.startswith("${"):
        return float(text)
    return float(_arithmetic(ast.parse(text[2:-1].strip(), mode="eval").body))


def _arithmetic(node: ast.AST) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return node.value
    if isinstance(node, ast.Name) and node.id == "pi":
        return np.pi
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_arithmetic(node.left), _arithmetic(node.right))
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_arithmetic(node.operand))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "radians" and len(node.args) == 1:
        return from_degrees(_arithmetic(node.args[0]))
    raise ValueError("not arithmetic")
