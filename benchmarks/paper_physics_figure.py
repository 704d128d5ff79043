"""The figure of docs/paper-physics.md, as plain SVG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

WIDTH, HEIGHT = 860, 470
COLOURS = {"paper": "#b5402a", "ml": "#1f5f99"}


def write_figure(path: Path, report: dict[str, Any], wanted: float) -> None:
    """Left: bar error of cells with nothing left out, by plan. Right: needed share of the plausible size, by effect and plan."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="11">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        *_noise(report["noise"], wanted),
        *_effects(report["effects"]),
        "</svg>",
    ]
    path.write_text("\n".join(parts) + "\n", encoding="utf-8")


def _noise(rows: list[dict[str, Any]], wanted: float) -> list[str]:
    names = [n for n in ("tree", "aim 10", "aim 3", "aim 1") if any(r["plan"] == n for r in rows)]
    left, right, top, bottom = 52, 380, 46, 420

    def y(mm: float) -> float:
        return bottom - (np.log10(max(mm, 1e-3)) + 3) / 4 * (bottom - top)

    out = [
        _text(left, 18, "Nothing left out: |mean error of a 735 mm bar| per cell, mm", bold=True),
        _text(left, 33, "one dot a cell; filled: joints 15 urad, hollow: 5 urad"),
    ]
    for k in range(-3, 2):
        out += [_line(left, y(10**k), right, y(10**k), "#ddd"), _text(left - 5, y(10**k) + 4, f"{10.0**k:g}", "end")]
    out += [_line(left, y(wanted), right, y(wanted), "#000", dash=True), _text(left + 3, y(wanted) - 4, "published 0.394")]
    step = (right - left) / len(names)
    for i, name in enumerate(names):
        middle = left + (i + 0.5) * step
        out.append(_text(middle, bottom + 16, "plan of this tree" if name == "tree" else f"{name} mm", "middle"))
        for r in (r for r in rows if r["plan"] == name):
            x = middle + (-14 if r["method"] == "paper" else 14) + (5 if r["urad"] > 10 else -5)
            fill = COLOURS[r["method"]] if r["urad"] > 10 else "none"
            out += [
                f'<circle cx="{x:.1f}" cy="{y(abs(m)):.1f}" r="2" fill="{fill}" stroke="{COLOURS[r["method"]]}" stroke-width="0.7"/>'
                for m in r["mean"]
            ]
    return [
        *out,
        _text(left, bottom + 36, "paper's method", colour=COLOURS["paper"]),
        _text(left + 100, bottom + 36, "maximum likelihood", colour=COLOURS["ml"]),
    ]


def _effects(tables: dict[str, list[dict[str, Any]]]) -> list[str]:
    best: dict[str, dict[str, float]] = {}
    for plan, rows in tables.items():
        for r in rows:
            if r["form"].startswith("(outside"):
                continue
            share = min(r["size"] / r["plausible"], 1e3)
            best.setdefault(r["family"], {})[plan] = min(share, best.get(r["family"], {}).get(plan, np.inf))
    order = sorted(best, key=lambda f: best[f]["tree"])
    left, right, top, bottom = 560, 845, 46, 420

    def x(share: float) -> float:
        return left + (np.log10(np.clip(share, 1e-3, 1e3)) + 3) / 6 * (right - left)

    out = [
        _text(415, 18, "Size that adds 0.394 mm, in shares of the largest plausible size (paper's method)", bold=True),
        _text(415, 33, "left of 1: a sound cell may have it; at 1000: never, or not visible"),
    ]
    for k in range(-3, 4):
        out += [
            _line(x(10.0**k), top, x(10.0**k), bottom, "#000" if k == 0 else "#ddd"),
            _text(x(10.0**k), bottom + 14, f"{10.0**k:g}", "middle"),
        ]
    marks = {"tree": "#000", "aim 10": "#d08a1d", "aim 3": "#7a4fa0"}
    step = (bottom - top) / max(len(order), 1)
    for i, family in enumerate(order):
        y = top + (i + 0.6) * step
        out.append(_text(left - 6, y + 3, family, "end"))
        out += [f'<circle cx="{x(s):.1f}" cy="{y:.1f}" r="4" fill="{marks[p]}"/>' for p, s in best[family].items()]
    for i, (plan, colour) in enumerate(marks.items()):
        out.append(_text(left + 95 * i, bottom + 34, "plan of this tree" if plan == "tree" else f"{plan} mm", colour=colour))
    return out


def _text(x: float, y: float, text: str, anchor: str = "start", *, bold: bool = False, colour: str = "#000") -> str:
    weight = ' font-weight="bold"' if bold else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}"{weight}>{text}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, *, dash: bool = False) -> str:
    style = ' stroke-dasharray="4 3"' if dash else ""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"{style}/>'
