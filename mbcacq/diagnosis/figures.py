"""Pictures of a diagnosis: an HTML page that opens offline, and error arrows before and after for the rerun viewer."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.diagnosis.locate import Spot
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.text import words

EXAGGERATED = 500.0  # arrows are drawn so much longer than they are


@dataclass(frozen=True)
class Evidence:
    """spots: makes the map before any effect. points: (M, 3) mm measured centres, base frame.

    before, after: (M, 3) mm residuals in base axes.

    covariates: name -> (M,) values.
    """

    spots: Callable[[], list[Spot]]
    points: np.ndarray
    before: np.ndarray
    after: np.ndarray
    covariates: dict[str, np.ndarray]


def write_html(diagnosis: Diagnosis, evidence: Evidence, path: Path) -> None:
    """One self-contained file."""
    figures = [heat_map(evidence), *along(diagnosis, evidence)]
    body = [figure.to_html(full_html=False, include_plotlyjs=(j == 0)) for j, figure in enumerate(figures)]
    page = f"""<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Diagnosis</title>
<style>body {{ font-family: sans-serif; max-width: 70rem; margin: 2rem auto; }} pre {{ white-space: pre-wrap; }}</style></head>
<body><h1>Diagnosis: {html.escape(diagnosis.verdict.replace("_", " "))}</h1>
<pre>{html.escape(words(diagnosis))}</pre>{"".join(body)}</body></html>"""
    path.write_text(page, encoding="utf-8")


def heat_map(evidence: Evidence):
    """Attachment by covariate: how improbable it is that chance explains as much (before any effect)."""
    import plotly.graph_objects as go

    spots = evidence.spots()
    at = list(dict.fromkeys(sorted((p.at for p in spots), key=lambda a: (a.rstrip("0123456789"), len(a), a))))
    on = list(dict.fromkeys(sorted((p.depends_on for p in spots), key=lambda a: (a.rstrip("0123456789"), len(a), a))))
    z = np.full((len(at), len(on)), np.nan)
    for p in spots:
        i, j = at.index(p.at), on.index(p.depends_on)
        z[i, j] = np.nanmax([z[i, j], min(-p.log10_p, 60.0)])
    figure = go.Figure(go.Heatmap(z=z, x=on, y=at, colorscale="Viridis", colorbar={"title": "-log10 p"}))
    figure.update_layout(title="Where and on what a mismatch depends, beyond free geometry", height=120 + 24 * len(at))
    return figure


def along(diagnosis: Diagnosis, evidence: Evidence) -> list:
    """Residual before and after along the variables held responsible."""
    import plotly.graph_objects as go

    names = [n for n in dict.fromkeys(m["depends_on"] for m in diagnosis.mismatch) if n in evidence.covariates][:3]
    out = []
    for name in names:
        x = evidence.covariates[name]
        figure = go.Figure()
        for label, residual, colour in (("before", evidence.before, "#b03a2e"), ("after", evidence.after, "#1a5276")):
            figure.add_trace(
                go.Scattergl(x=x, y=np.linalg.norm(residual, axis=1), mode="markers", name=label, marker={"size": 4, "color": colour})
            )
        figure.update_layout(title=f"Size of the residual along {name}", xaxis_title=name, yaxis_title="mm", height=360)
        out.append(figure)
    return out


def write_rrd(evidence: Evidence, path: Path) -> None:
    """Arrows in the base frame, mm, exaggerated; entities /before and /after."""
    import rerun as rr

    stream = rr.RecordingStream("mbcacq_diagnosis")
    stream.save(str(path))
    for name, residual, colour in (("before", evidence.before, [176, 58, 46]), ("after", evidence.after, [26, 82, 118])):
        stream.log(name, rr.Arrows3D(origins=evidence.points, vectors=EXAGGERATED * residual, colors=[colour]), static=True)
    stream.log("scale", rr.TextLog(f"arrows are {EXAGGERATED:g} times as long as the errors"), static=True)
    stream.flush()
