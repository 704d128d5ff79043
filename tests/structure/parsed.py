"""The sources of the program, parsed and walked once for all tests that look at them."""

from __future__ import annotations

import ast
import gc
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).parents[2]
FOLDERS = ("mbcacq", "drivers", "fakes")
N = TypeVar("N", bound=ast.AST)


@cache
def sources() -> dict[Path, dict[type, list[Any]]]:
    """The nodes of each file by their kind: a million that stay, through which the garbage collector need not look again and again."""
    out = {}
    gc.disable()
    for path in (p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py")):
        out[path] = by_kind = defaultdict(list)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            by_kind[type(node)].append(node)
    gc.freeze()
    gc.enable()
    return out


def nodes(*kinds: type[N]) -> Iterator[tuple[Path, N]]:
    """(path, node) of every node of these kinds."""
    for path, by_kind in sources().items():
        for kind in kinds:
            for node in by_kind.get(kind, ()):
                yield path, node
