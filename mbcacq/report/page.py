"""The page itself: one HTML file with everything in it, readable offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbcacq.errors import RecordingError
from mbcacq.report.content import Content
from mbcacq.report.tables import groups, held, matrices


def render(content: Content) -> str:
    """HTML of a report. Every text is escaped; the plotting library is inlined once."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "signed": signed}
    return environment.get_template("page.html.j2").render(
        c=content, figures=_figures(content), plotly=Markup(get_plotlyjs()), np=np,
        groups=groups(content), matrices=matrices(content), held=held(content),
    )


def write(content: Content, path: str | Path) -> Path:
    """Write the page; the folder is made where it is missing. Raises RecordingError where it cannot be written."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(render(content), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{path}: the report cannot be written: {error.strerror}; free space or give another folder") from error
    return path


def number(value: float | None, digits: int = 3) -> str:
    """Fixed point with a typographic minus; a dash where there is no value."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.{digits}f}".replace("-", "−")


def signed(value: float | None, digits: int = 3) -> str:
    text = number(value, digits)
    return text if text in "–" or text.startswith("−") else f"+{text}"


def _figures(content: Content) -> dict:
    from mbcacq.report import charts

    figures = {}
    if content.spacing is not None:
        figures["spacing"] = charts.spacing(content.spacing)
    if content.residuals is not None and len(content.residuals.xyz):
        figures["pose"] = charts.residual_per_pose(content.residuals)
        figures["ball"] = charts.residual_per_ball(content.residuals)
        figures["ball_mean"] = charts.residual_mean_per_ball(content.residuals)
        if content.residuals.weighted is not None:
            figures["histogram"] = charts.histogram(content.residuals)
    if content.correlation is not None and len(content.correlation[0]) > 1:
        figures["correlation"] = charts.correlation(*content.correlation)
    if content.coverage is not None and len(content.coverage.q_deg):
        figures["joints"] = charts.joint_coverage(content.coverage)
        if content.coverage.flange is not None:
            figures["places"] = charts.place_coverage(content.coverage)
    return {name: _div(name, figure) for name, figure in figures.items()}


def _div(name: str, figure):
    from markupsafe import Markup

    text = figure.to_html(full_html=False, include_plotlyjs=False, div_id=f"figure-{name}",
                          config={"displayModeBar": False, "responsive": True})
    return Markup(text)
