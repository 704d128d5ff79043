"""Draws docs/diagnosis.svg: the seven steps of a diagnosis, what each hands to the next, and what is repeated.

``python docs/_make/diagnosis_figure.py`` from the root of the checkout.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

TARGET = Path(__file__).resolve().parents[1] / "diagnosis.svg"
WIDTH, TOP, ROW, BOX_W, BOX_H, LEFT = 860, 34, 76, 250, 44, 100
INK, PALE, LINE, NOTE = "#333333", "#eef2f6", "#5b7fa6", "#555555"
STEPS = (
    ("1. Fit the geometry", "arm, hand-eye transform, stations, balls: residual r", "gross outliers rejected"),
    ("2. Estimate the noise", "variance components by REML: covariance V", "priors: stated noise, repeatability"),
    ("3. Map the mismatch", "log Bayes factor of each location, covariate and shape", "evidence map"),
    ("4. Search for effects", "sets of effects with their evidence and odds", "e-value, most probable set, alternatives"),
    ("5. Limit what was not found", "size of each effect that is excluded at 95 %", "exclusion limits, verdict none or cannot_tell"),
    ("6. Cross-validate", "step 4 without each fold, then the fold predicted", "held-out rms and chi², gain of each effect"),
    ("7. Propose a formula", "for an unmodelled effect, with --propose", "draft of an effect for the catalogue"),
)
AGAIN = ((3, 0, "linearised anew with the best set"), (5, 3, "repeated for each fold"))  # from step, to step, why


def top_of(step: int) -> int:
    """y of the upper edge of a step's box."""
    return TOP + step * ROW


def box(step: int) -> str:
    title, does, gives = (escape(text) for text in STEPS[step])
    y, right = top_of(step), LEFT + BOX_W + 20
    return (
        f'<rect x="{LEFT}" y="{y}" width="{BOX_W}" height="{BOX_H}" rx="5" fill="{PALE}" stroke="{INK}"/>'
        f'<text x="{LEFT + 14}" y="{y + 28}" font-size="16">{title}</text>'
        f'<text x="{right}" y="{y + 18}" font-size="14">{does}</text>'
        f'<text x="{right}" y="{y + 37}" font-size="14" fill="{NOTE}">{gives}</text>'
    )


def down(step: int) -> str:
    """Arrow from a step to the next one."""
    x, y = LEFT + BOX_W // 2, top_of(step) + BOX_H
    return f'<path d="M{x},{y} V{y + ROW - BOX_H - 5}" marker-end="url(#tip)"/>'


def back(start: int, end: int, column: int) -> str:
    """Arrow on the left from a step to an earlier one. column: number of the arrow."""
    x, y1, y2 = LEFT - 40, top_of(start) + BOX_H // 2 - 8 * column, top_of(end) + BOX_H // 2 + 8 * column
    return f'<path d="M{LEFT},{y1} H{x} V{y2} H{LEFT - 5}" stroke-dasharray="6 4" marker-end="url(#tip)"/>'


def reason(start: int, end: int, text: str) -> str:
    """Words of an arrow that leads back, along it."""
    x, y = LEFT - 48, (top_of(start) + top_of(end) + BOX_H) // 2
    return f'<text x="{x}" y="{y}" font-size="13" fill="{NOTE}" text-anchor="middle" transform="rotate(-90 {x} {y})">{escape(text)}</text>'


def draw() -> str:
    height = top_of(len(STEPS) - 1) + BOX_H + TOP
    arrows = [down(step) for step in range(len(STEPS) - 1)]
    arrows += [back(start, end, number) for number, (start, end, _) in enumerate(AGAIN)]
    words = [reason(*again) for again in AGAIN]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" fill="{INK}" role="img">'
        f'<title>The seven steps of a diagnosis</title><rect width="{WIDTH}" height="{height}" fill="white"/>'
        f'<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
        f'<path d="M0,0 L8,4 L0,8 z" fill="{LINE}"/></marker></defs>'
        f'<g fill="none" stroke="{LINE}" stroke-width="1.6">{"".join(arrows)}</g>'
        f"{''.join(box(step) for step in range(len(STEPS)))}{''.join(words)}</svg>\n"
    )


if __name__ == "__main__":
    TARGET.write_text(draw(), encoding="utf-8")
    print(f"wrote {TARGET}")
