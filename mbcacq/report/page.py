"""A page: one HTML file with everything in it, readable offline."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from mbcacq.effects.in_words import spelt_out
from mbcacq.figure import Figure, drawing_library
from mbcacq.files.template import environment_of
from mbcacq.quantities import capitalised, fixed, pair, signed, uncertainty
from mbcacq.report.charts import change_charts
from mbcacq.report.charts.check_charts import check_figures
from mbcacq.report.charts.spacing_svg import slider_pictures, spacing_picture, stages_picture
from mbcacq.report.charts.static_svg import static_svg
from mbcacq.report.charts.style import PHASES, thinned
from mbcacq.report.content import Content, DiagnosisContent, Spacing
from mbcacq.report.figures import diagnosis_figures, fleet_figures, report_figures
from mbcacq.report.several import FleetContent, RunComparison
from mbcacq.report.tables import groups, held, matrices
from mbcacq.report.verdict import quantity

HERE = Path(__file__).parent
PAGE_SCRIPT, SCENE_SCRIPT = HERE / "page.js", HERE / "scene.js"
WHOLE_WIDTH, HALF_WIDTH, THIRD_WIDTH = 680.0, 330.0, 215.0  # px of CSS, on A4 with the margins of the page
PAPER_HEIGHT, CORRELATION_HEIGHT = 0.8, 0.72  # over that on the screen
WHOLE_WIDTH_FIGURES = ("pose", "joints", "states", "correlation", "evidence_map")


def render(content: Content, *, paper: bool = False) -> str:
    """HTML of a report. Every text is escaped; the plotting library is inlined once. paper: figures as pictures, and nothing that moves."""
    picture = None if content.spacing is None else Markup(spacing_picture(content.spacing))
    stages = "" if content.earlier is None or content.spacing is None else Markup(stages_of(content.earlier, content.spacing))
    motion = content.motion
    if motion is not None and paper:  # curves over time are for the screen, where they can be enlarged
        motion = replace(motion, kinds=[replace(kind, series=[]) for kind in motion.kinds])
    figures = report_figures(content) | _figures_of(content.diagnosis, motion)
    return _template(
        "page.html.j2",
        c=content,
        figures=static_figures(figures) if paper else _embedded(figures),
        paper=paper,
        np=np,
        picture=picture,
        slides=[] if content.spacing is None else map(Markup, slider_pictures(content.spacing)),
        stages=stages,
        groups=groups(content),
        matrices=matrices(content),
        held=held(content),
        poses=content.diagnosis,
        motion=motion,
        scene=None if paper else _scene(content),
    )


def stages_of(geometry: Spacing, with_effects: Spacing) -> str:
    """SVG of the bar before calibration, after geometry, and after effects."""
    stages = {"before": with_effects.before, "after calibration": geometry.after, "after effects": with_effects.after}
    expected = None if with_effects.sigma is None else float(np.sqrt(2 / np.pi) * np.mean(with_effects.sigma))
    return stages_picture(with_effects.place, stages, expected)


def _scene(content: Content) -> Any:
    """What the view that turns draws, as JSON: points by phase and the arm, mm in the base; None where no ball has a place."""
    coverage = content.coverage
    if coverage is None or coverage.balls is None or coverage.ball_phase is None:
        return None
    groups = []
    for k, phase in enumerate(dict.fromkeys(coverage.ball_phase)):
        points = coverage.balls[coverage.ball_phase == phase]
        points = points[thinned(np.zeros(len(points)))]
        groups.append({"name": str(phase) or "all poses", "colour": PHASES[k % len(PHASES)], "points": np.round(points, 1).tolist()})
    arm, radii = ([] if each is None else np.round(each, 1).tolist() for each in (coverage.arm, coverage.arm_radii))
    return Markup(_script_safe(json.dumps({"groups": groups, "arm": arm, "radii": radii})))


def render_diagnosis(
    diagnosis: DiagnosisContent | None, motion: DiagnosisContent | None, title: str, about: Sequence[tuple[str, str]] = ()
) -> str:
    """HTML of a diagnosis by itself, of poses, of motion or of both. about: robot, data and date (label, text)."""
    figures = _embedded(_figures_of(diagnosis, motion))
    return _template("diagnosis_page.html.j2", poses=diagnosis, motion=motion, title=title, about=about, figures=figures)


def _figures_of(*each: DiagnosisContent | None) -> dict[str, Figure]:
    """The figures of the poses and of the motion, as far as they are there."""
    return {name: figure for one in each if one is not None for name, figure in diagnosis_figures(one).items()}


def render_fleet(fleet: FleetContent, title: str = "Fleet") -> str:
    """HTML of a fleet."""
    return _template("fleet_page.html.j2", f=fleet, title=title, figures=_embedded(fleet_figures(fleet)))


def render_changes(changes: RunComparison, spacings: Sequence[tuple[str, Spacing]], *, simulated: bool) -> str:
    """HTML of two recordings compared. spacings: the verification of each that has one, by its name."""
    figures = {name: change_charts.changes(rows) for _, name, rows in changes.charts}
    pictures = [(name, Markup(spacing_picture(spacing))) for name, spacing in spacings]
    return _template("changes_page.html.j2", c=changes, figures=_embedded(figures), pictures=pictures, simulated=simulated)


def render_check(kept: Mapping[str, Any], *, paper: bool = False) -> str:
    """HTML of a check, of what it left in its folder."""
    figures = check_figures(dict(kept))
    drawn = static_figures(figures) if paper else _embedded(figures)
    return _template("check_page.html.j2", k=kept, changed=kept["verdict"] == "changed", figures=drawn, paper=paper)


def curve_title(effect: str, location: str) -> str:
    return f"{capitalised(spelt_out(effect))} at {location}"


FILTERS = {
    "number": fixed,
    "signed": signed,
    "pair": pair,
    "uncertainty": uncertainty,
    "curve_title": curve_title,
    "quantity": quantity,
    "capitalised": capitalised,
}


def _template(name: str, **values: Any) -> str:
    scripts = "\n".join(path.read_text(encoding="utf-8") for path in (PAGE_SCRIPT, SCENE_SCRIPT))
    kept = {"css": Markup((HERE / "page.css").read_text(encoding="utf-8")), "js": Markup(scripts)}
    environment = environment_of(HERE)
    environment.filters |= FILTERS
    return environment.get_template(name).render(plotly=Markup(drawing_library()), **kept, **values)


def static_figures(figures: Mapping[str, Figure]) -> dict[str, Any]:
    """Each figure as a picture of the width that it has on paper."""

    out = {}
    for name, figure in figures.items():
        width = WHOLE_WIDTH if name in WHOLE_WIDTH_FIGURES else THIRD_WIDTH if name.startswith("axis_") else HALF_WIDTH
        data = base64.b64encode(static_svg(figure, width, PAPER_HEIGHT if name != "correlation" else CORRELATION_HEIGHT).encode()).decode()
        out[name] = Markup(f'<img class="picture" alt="{name.replace("_", " ")}" src="data:image/svg+xml;base64,{data}">')
    return out


def _embedded(figures: Mapping[str, Figure]) -> dict[str, Any]:
    return {name: _div(name, figure) for name, figure in figures.items()}


def _div(name: str, figure: Figure) -> Any:
    """The figure as data next to its place: page.js draws it. Text that could end a script element is written as an escape."""
    data = _script_safe(figure.to_json())
    height = figure.layout.get("height", 300)
    return Markup(
        f'<div class="plot" id="figure-{name}" data-figure="data-{name}" style="height:{height:g}px"></div>'
        f'<script type="application/json" id="data-{name}">{data}</script>'
    )


def _script_safe(json_text: str) -> str:
    """JSON in a script element: what could end it is written as an escape."""
    return json_text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
