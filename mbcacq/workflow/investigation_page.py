"""The page "how it was found": block by block, what was doubted, what was chosen, what came out."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from mbcacq.design.adaptive.investigation import Decision
from mbcacq.files.atomic_write import write_file

PAGE = "how-it-was-found.html"
WIDTH, HEIGHT, MARGIN = 640.0, 180.0, 36.0
STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{border-top:1px solid #ccc;padding:.4em .8em;text-align:left;vertical-align:top}"
    "svg text{font-size:11px;fill:#444}"
)


def write_investigation_page(folder: Path, name: str, decisions: Sequence[Decision]) -> Path:
    """Write the page into the folder of the run; it opens offline."""
    rows = "".join(_row(d) for d in decisions)
    end = escape(decisions[-1].end or "the investigation is not finished") if decisions else "nothing was measured"
    head = "<tr><th>poses</th><th>moves</th><th>what is possible, odds</th><th>verdict</th><th>in question</th><th>next</th></tr>"
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>How it was found: {escape(name)}</title><style>{STYLE}</style>'
        f"<h1>How it was found: {escape(name)}</h1><p>{end}.</p>{_evidence_curve(decisions)}<table>{head}{rows}</table></html>"
    )
    write_file(folder / PAGE, page)
    return folder / PAGE


def _row(d: Decision) -> str:
    possible = "<br>".join(f"{escape(name)}{f' ({odds:.2g} : 1)' if k else ''}" for k, (name, odds) in enumerate(d.sets))
    then = "<br>".join(f"{len(s['poses_deg'])} poses at station {escape(str(s['station']))}" for s in d.steps) or escape(d.end)
    reasons = "<br>".join(map(escape, d.reasons))
    cells = (str(d.poses), str(d.moves), possible, escape(d.verdict), reasons, then)
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _evidence_curve(decisions: Sequence[Decision]) -> str:
    """Log10 of the e-value over the poses, with the threshold of 100."""
    if len(decisions) < 2:
        return ""
    x = np.array([d.poses for d in decisions], dtype=float)
    y = np.array([d.log_e_value for d in decisions]) / np.log(10)
    low, high = min(-1.0, float(y.min())), max(3.0, float(y.max()))
    across = MARGIN + (WIDTH - 2 * MARGIN) * (x - x[0]) / max(x[-1] - x[0], 1.0)
    up = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * (y - low) / (high - low)
    threshold = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * (2.0 - low) / (high - low)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, up, strict=True))
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="#1f5fa8"/>' for a, b in zip(across, up, strict=True))
    labels = "".join(f'<text x="{a:.1f}" y="{HEIGHT - 12:.0f}" text-anchor="middle">{n:.0f}</text>' for a, n in zip(across, x, strict=True))
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img" aria-label="evidence over poses">'
        f'<line x1="{MARGIN}" x2="{WIDTH - MARGIN}" y1="{threshold:.1f}" y2="{threshold:.1f}" stroke="#a33" stroke-dasharray="4 3"/>'
        f'<text x="{MARGIN}" y="{threshold - 4:.1f}">an effect: 100 : 1</text>'
        f'<polyline points="{points}" fill="none" stroke="#1f5fa8" stroke-width="2"/>{dots}{labels}'
        f'<text x="{WIDTH / 2:.0f}" y="{HEIGHT - 1:.0f}" text-anchor="middle">poses; log10 of the evidence against none</text></svg>'
    )
