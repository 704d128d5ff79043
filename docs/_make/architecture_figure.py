"""Draws docs/explanation/architecture.svg from the imports of the code: packages in their layers, arrows for imports.

``python docs/_make/architecture_figure.py`` from the root of the checkout.
"""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "docs" / "explanation" / "architecture.svg"
PACKAGE = ROOT / "mbcacq"
WIDTH, LAYER, BOX_H, TOP = 980, 74, 40, 30
INK, PALE, LINE = "#333333", "#eef2f6", "#5b7fa6"
UNDER = ("errors", "quantities")  # what nearly everything imports: shown without arrows


def layers() -> list[list[str]]:
    """Packages by layer, top layer first, as the import contract in pyproject.toml has them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    stated = next(c["layers"] for c in contracts if c.get("containers") == ["mbcacq"])
    return [[package.strip() for package in layer.split("|")] for layer in stated]


def package_of(module: str) -> str:
    return module.split(".")[1] if module.startswith("mbcacq.") else ""


def imports() -> Counter[tuple[str, str]]:
    """(package, imported package) -> number of import statements, those inside functions too."""
    found: Counter[tuple[str, str]] = Counter()
    for path in sorted(PACKAGE.rglob("*.py")):
        here = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = (
                [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else []
            )
            for name in names:
                there = package_of(name)
                if there and there != here and here != "__init__":
                    found[here, there] += 1
    return found


def shown(found: Counter[tuple[str, str]]) -> list[tuple[str, str]]:
    """The arrows to draw: those that no chain of others implies (the transitive reduction)."""
    below: dict[str, set[str]] = {}
    for a, b in found:
        below.setdefault(a, set()).add(b)

    def reached(package: str) -> set[str]:
        return set().union(*({b} | reached(b) for b in below.get(package, ())), set())

    return sorted((a, b) for a, b in found if b not in UNDER and not any(b in reached(c) for c in below[a] - {b}))


def places() -> dict[str, tuple[float, float, float]]:
    """Package -> x of its centre, y of its top, width of its box."""
    out = {}
    for level, packages in enumerate(layers()):
        widths = [max(86.0, 9.0 * len(package) + 26) for package in packages]
        gap = (WIDTH - sum(widths)) / (len(packages) + 1)
        x = gap
        for package, width in zip(packages, widths, strict=True):
            out[package] = (x + width / 2, TOP + level * LAYER, width)
            x += width + gap
    return out


def arrow(a: tuple[float, float, float], b: tuple[float, float, float]) -> str:
    (x1, y1, _), (x2, y2, _) = a, b
    y1 += BOX_H
    mid = (y1 + y2) / 2
    return f'<path d="M{x1:.0f},{y1:.0f} C{x1:.0f},{mid:.0f} {x2:.0f},{mid:.0f} {x2:.0f},{y2 - 5:.0f}" marker-end="url(#tip)"/>'


def draw() -> str:
    at = places()
    height = TOP + len(layers()) * LAYER
    found = imports()
    arrows = [arrow(at[a], at[b]) for a, b in shown(found)]
    boxes = []
    for package, (x, y, width) in at.items():
        boxes.append(
            f'<rect x="{x - width / 2:.0f}" y="{y:.0f}" width="{width:.0f}" height="{BOX_H}" rx="5" fill="{PALE}" stroke="{INK}"/>'
            f'<text x="{x:.0f}" y="{y + 25:.0f}" text-anchor="middle">{package}</text>'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" font-size="15" fill="{INK}">'
        f'<title>Packages of mbcacq in their layers</title><rect width="{WIDTH}" height="{height}" fill="white"/>'
        f'<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
        f'<path d="M0,0 L8,4 L0,8 z" fill="{LINE}"/></marker></defs>'
        f'<g fill="none" stroke="{LINE}" stroke-width="1.4" stroke-opacity="0.7">'
        f"{''.join(arrows)}</g>{''.join(boxes)}</svg>\n"
    )


if __name__ == "__main__":
    TARGET.write_text(draw(), encoding="utf-8")
    print(f"wrote {TARGET}")
