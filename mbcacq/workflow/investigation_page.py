"""The page "how it was found": block by block, what was doubted, what was chosen, what came out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from mbcacq.design.adaptive.investigation import Decision
from mbcacq.files.atomic_write import write_file
from mbcacq.quantities import capitalised, power_of_ten

PAGE = "how-it-was-found.html"
WIDTH, HEIGHT, LEFT, BELOW, ABOVE = 640.0, 220.0, 64.0, 44.0, 16.0
AN_EFFECT = 2.0  # log10 of the evidence from which there is one
VERDICTS = {"none": "no effect", "cannot_tell": "cannot tell yet", "partly_explained": "partly explained"}
STYLE = (
    ":root{color-scheme:light dark}body{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em}"
    ".scroll{overflow-x:auto}table{border-collapse:collapse}td,th{border-top:1px solid #999;padding:.4em .8em;text-align:left;"
    "vertical-align:top}svg{max-width:100%;height:auto}svg text{font-size:12px;fill:currentColor}"
)


def write_investigation_page(folder: Path, name: str, decisions: Sequence[Decision]) -> Path:
    """Write the page into the folder of the run; it opens offline."""
    rows = "".join(_row(d) for d in decisions)
    end = escape(decisions[-1].end or "the investigation is not finished") if decisions else "nothing was measured"
    heads = ("poses measured", "moves of the arm", "possible explanations (odds of the first)", "verdict", "in question", "measured next")
    head = "<tr>" + "".join(f'<th scope="col">{one}</th>' for one in heads) + "</tr>"
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>How it was found: {escape(name)}</title><style>{STYLE}</style><main>"
        f"<h1>How it was found: {escape(name)}</h1><p>{capitalised(end)}.</p>{_evidence_curve(decisions)}"
        f'<div class="scroll" tabindex="0" role="region" aria-label="each look"><table>{head}{rows}</table></div></main></html>'
    )
    write_file(folder / PAGE, page)
    return folder / PAGE


def _row(d: Decision) -> str:
    possible = "<br>".join(f"{_words(name)}{f' ({odds:.2g} : 1)' if k else ''}" for k, (name, odds) in enumerate(d.sets))
    then = "<br>".join(f"{len(s['poses_deg'])} poses at station {escape(str(s['station']))}" for s in d.steps) or escape(d.end)
    reasons = "<br>".join(map(_words, d.reasons))
    cells = (str(d.poses), str(d.moves), possible, escape(VERDICTS.get(d.verdict, d.verdict)), reasons, then)
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _words(said: str) -> str:
    """A station has its name by itself: 'stationc2' is its location in an effect."""
    return escape(re.sub(r"\bstation(?=[A-Za-z0-9])(?!s\b)", "station ", said))


def _evidence_curve(decisions: Sequence[Decision]) -> str:
    """Log10 of the e-value over the poses, with the threshold of 100."""
    if len(decisions) < 2:
        return ""
    x = np.array([d.poses for d in decisions], dtype=float)
    y = np.array([d.log_e_value for d in decisions]) / np.log(10)
    low, high = np.floor(min(-1.0, float(y.min()))), np.ceil(max(3.0, float(y.max())))
    across = LEFT + (WIDTH - LEFT - 20) * (x - x[0]) / max(x[-1] - x[0], 1.0)

    def up(value: float) -> float:
        return HEIGHT - BELOW - (HEIGHT - BELOW - ABOVE) * (value - low) / (high - low)

    ticks = np.unique(np.round(np.linspace(low, high, 5)))
    scale = "".join(
        f'<line x1="{LEFT}" x2="{WIDTH - 20}" y1="{up(t):.1f}" y2="{up(t):.1f}" stroke="#8884"/>'
        f'<text x="{LEFT - 6}" y="{up(t) + 4:.1f}" text-anchor="end">{power_of_ten(10.0**t)}</text>'
        for t in ticks
    )
    points = " ".join(f"{a:.1f},{up(b):.1f}" for a, b in zip(across, y, strict=True))
    dots = "".join(f'<circle cx="{a:.1f}" cy="{up(b):.1f}" r="3" fill="#2f7fc8"/>' for a, b in zip(across, y, strict=True))
    labels = "".join(
        f'<text x="{a:.1f}" y="{HEIGHT - BELOW + 18:.0f}" text-anchor="middle">{n:.0f}</text>' for a, n in zip(across, x, strict=True)
    )
    at = up(AN_EFFECT)
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img" aria-label="evidence for an effect over the number of poses">{scale}'
        f'<line x1="{LEFT}" x2="{WIDTH - 20}" y1="{at:.1f}" y2="{at:.1f}" stroke="#c44" stroke-dasharray="4 3"/>'
        f'<text x="{LEFT + 4}" y="{at - 4:.1f}">an effect: 100 : 1</text>'
        f'<polyline points="{points}" fill="none" stroke="#2f7fc8" stroke-width="2"/>{dots}{labels}'
        f'<text x="{WIDTH / 2:.0f}" y="{HEIGHT - 6:.0f}" text-anchor="middle">poses measured</text>'
        f'<text transform="translate(14 {(HEIGHT - BELOW) / 2:.0f}) rotate(-90)" text-anchor="middle">odds of an effect</text></svg>'
    )
