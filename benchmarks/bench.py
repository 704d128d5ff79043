"""What the benchmarks share: where things are, commands of a script, pages, outcomes that are kept, tables and pictures.

``import bench`` comes before other imports of a benchmark: it makes the simulated cells of the tests importable.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
PLANS, TESTS = ROOT / "plans", ROOT / "tests"
SHARED = Path("../shared/data")  # measured recordings, beside the checkout
MBCACQ = Path(sys.executable).parent / "mbcacq"
END = "<!-- end -->\n"
COLOURS = ("#1f6fb2", "#e08a1e")

sys.path[:0] = [str(TESTS), *(str(TESTS / name) for name in ("calibration", "camera", "diagnosis", "motion", "recording", "spheres"))]

Option = tuple[tuple[str, ...], dict[str, Any]]


def option(*names: str, **settings: Any) -> Option:
    """An argument of a command, as ``ArgumentParser.add_argument`` takes it."""
    return names, settings


def writes(page: str) -> Option:
    return option("--write", action="store_true", help=f"put the table into {page}")


def keeps(name: str) -> Option:
    """Outcomes are added to this file at once; what is in it is not repeated."""
    return option("--kept", type=Path, default=HERE / name, help="outcomes so far; go on with them")


DATA = option("--data", type=Path, default=SHARED, help="folder of the measured recordings")


def main(doc: str | None, commands: dict[str, tuple[Callable[[argparse.Namespace], int | None], list[Option]]]) -> int:
    """Run one of the commands of a script: name -> (function, its arguments). The docstring of a function is its help. Returns an exit
    code.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    each = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (function, options) in commands.items():
        text = function.__doc__ or ""
        one = each.add_parser(name, help=text.split("\n")[0], description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
        for names, settings in options:
            one.add_argument(*names, **settings)
        one.set_defaults(function=function)
    given = parser.parse_args()
    if getattr(given, "data", None) is not None and not given.data.is_dir():
        where = "docs/data/README.md names where these recordings are published; --data FOLDER says where they lie"
        parser.error(f"{given.data} is not there: {where}")
    return given.function(given) or 0


def machine() -> str:
    """What a time was measured on, in one line."""
    return f"{os.cpu_count()} cores {platform.machine()}, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}"


class Kept:
    """Outcomes in a file of JSON lines: those of earlier calls, and what is added, each at once."""

    def __init__(self, file: Path | None) -> None:
        self.file = file
        there = file is not None and file.exists()
        self.rows: list[dict[str, Any]] = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if there else []

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append(row)
        if self.file is not None:
            with self.file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(row) + "\n")


def put(page: Path, text: str, begin: str = "<!-- table -->\n", end: str = END) -> None:
    """Replace what a page has between two marks; what is outside stays as it was written."""
    before, _, after = (page.read_text(encoding="utf-8") if page.exists() else "").partition(begin)
    page.write_text(f"{before}{begin}{text}\n{end}{after.partition(end)[2]}", encoding="utf-8")


def changed_plan(name: str, file: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A shipped plan with a change, its files named from where it now lies."""
    import yaml

    plan = yaml.safe_load((PLANS / name).read_text(encoding="utf-8"))
    plan["robot"]["model"] = str(PLANS / plan["robot"]["model"])
    plan["artefacts"] = [str(PLANS / artefact) for artefact in plan["artefacts"]]
    change(plan)
    file.write_text(yaml.safe_dump(plan, sort_keys=False), encoding="utf-8")
    return file


def table(heads: Sequence[str], rows: Iterable[Sequence[object]] = ()) -> list[str]:
    """Lines of a Markdown table."""
    return [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *(f"| {' | '.join(map(str, row))} |" for row in rows)]


def counted(counts: Counter, heads: Sequence[str], ways: Sequence[Any], order: Callable[[tuple], Any] | None = None) -> list[str]:
    """Lines of a table of counts by (*key, way): a row a key, a column a way."""
    keys = sorted({key[:-1] for key in counts}, key=order)
    return table([*heads, *map(str, ways)], [[*key, *(counts[(*key, way)] or "" for way in ways)] for key in keys])


def wilson(yes: int, n: int) -> tuple[float, float]:
    """95 % interval of a rate, in percent (Wilson)."""
    p = yes / n
    middle, half = (p + 1.92 / n) / (1 + 3.84 / n), 1.96 * (p * (1 - p) / n + 0.96 / n**2) ** 0.5 / (1 + 3.84 / n)
    return max(100 * (middle - half), 0.0), min(100 * (middle + half), 100.0)


def svg(width: float, height: float, parts: Iterable[str], size: int = 11) -> str:
    """A picture on white."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" font-family="sans-serif" font-size="{size}">'
    return "\n".join([head, rect(0, 0, width, height, "#ffffff"), *parts, "</svg>", ""])


def rect(x: float, y: float, width: float, height: float, fill: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{fill}"/>'


def line(x1: float, y1: float, x2: float, y2: float, colour: str, *, dash: bool = False) -> str:
    style = ' stroke-dasharray="4 3"' if dash else ""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"{style}/>'


def curve(points: Iterable[tuple[float, float]], colour: str, width: float = 1.0) -> str:
    shown = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{shown}" fill="none" stroke="{colour}" stroke-width="{width:g}"/>'


def text(x: float, y: float, words: str, size: int = 11, anchor: str = "start", *, colour: str = "#222222", bold: bool = False) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="{anchor}" fill="{colour}"{weight}>{escape(words)}</text>'
