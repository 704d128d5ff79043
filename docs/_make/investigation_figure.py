"""The picture of an investigation: what is possible after each block, from the decisions in a run folder.

    python docs/_make/investigation_figure.py RUN    # writes docs/investigation.svg

RUN: of ``mbcacq investigate plans/concealed.yaml --dry-run``.
"""

from __future__ import annotations

import json
import sys
from html import escape
from pathlib import Path

import numpy as np

from mbcacq.design.adaptive.investigation import Decision
from mbcacq.model.json_text import from_fields

OUT = Path(__file__).parents[1] / "investigation.svg"
WIDTH, LEFT, TOP, LINE = 760, 150, 46, 16
NAMED, HIDING = "#1f5fa8", "#b9c3d0"
OPEN = 260  # px of the bar of the whole catalogue
MOST_NAMES = 5  # lines of names in a row


def draw(decisions: list[Decision]) -> str:
    """SVG: a row for each look, with its poses, the effects of the most probable set, and the share of the catalogue that could hide."""
    names = [d.sets[0][0].replace("_", " ").split(" and ")[:MOST_NAMES] if d.sets else [] for d in decisions]
    tops = TOP + np.cumsum([0] + [LINE * max(len(some), 1) + 12 for some in names])
    height = int(tops[-1]) + 32
    rows = [_row(int(y), d, some) for y, d, some in zip(tops[:-1], decisions, names, strict=True)]
    head = (
        f'<text x="12" y="26" font-weight="600">poses, moves</text><text x="{LEFT}" y="26" font-weight="600">effects that are named</text>'
        f'<text x="{WIDTH - OPEN - 12}" y="26" font-weight="600">of the catalogue excluded, <tspan fill="#777">could hide</tspan></text>'
    )
    foot = f'<text x="12" y="{height - 14}" fill="#555">{escape(_end(decisions[-1]))}</text>'
    paper = '<rect width="100%" height="100%" fill="#fff"/>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="an investigation, block by block" '
        f'font-family="system-ui, sans-serif" font-size="12">{paper}{head}{"".join(rows)}{foot}</svg>\n'
    )


def _row(y: int, d: Decision, names: list[str]) -> str:
    marks = "".join(f'<text x="{LEFT}" y="{y + 15 + LINE * k}" fill="{NAMED}">{escape(name)}</text>' for k, name in enumerate(names))
    x, width = WIDTH - OPEN - 12, OPEN * d.excluded
    bar = (
        f'<rect x="{x}" y="{y + 5}" width="{OPEN}" height="12" fill="{HIDING}"/>'
        f'<rect x="{x}" y="{y + 5}" width="{width:.1f}" height="12" fill="{NAMED}"/>'
    )
    return f'<text x="12" y="{y + 15}">{d.poses} poses, {d.moves} moves</text>{marks}{bar}'


def _end(d: Decision) -> str:
    return f"ended after {d.poses} poses and {d.moves} moves of an artefact: {d.verdict.replace('_', ' ')}"


def main() -> None:
    content = json.loads((Path(sys.argv[1]) / "investigation.json").read_text(encoding="utf-8"))
    OUT.write_text(draw([from_fields(Decision, one) for one in content["decisions"]]), encoding="utf-8")


if __name__ == "__main__":
    main()
