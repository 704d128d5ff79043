"""The page itself: one HTML file with everything in it, readable offline."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import RecordingError
from mbcacq.report.content import Content
from mbcacq.report.sources.diagnosis_content import DiagnosisContent
from mbcacq.report.tables import groups, held, matrices
from mbcacq.report.verdict import readable

HERE = Path(__file__).parent


def render(content: Content) -> str:
    """HTML of a report. Every text is escaped; the plotting library is inlined once."""
    from markupsafe import Markup

    from mbcacq.report.charts.svg import spacing_picture

    picture = None if content.spacing is None else Markup(spacing_picture(content.spacing))
    figures = _figures(content) | ({} if content.diagnosis is None else _of_diagnosis(content.diagnosis))
    return _template(
        "page.html.j2",
        c=content,
        figures=figures,
        np=np,
        picture=picture,
        groups=groups(content),
        matrices=matrices(content),
        held=held(content),
        d=content.diagnosis,
    )


def render_diagnosis(told: DiagnosisContent, title: str) -> str:
    """HTML of a diagnosis by itself."""
    return _template("diagnosis_page.html.j2", d=told, title=title, figures=_of_diagnosis(told))


def write(html: str, path: str | Path) -> Path:
    """Write a page; the folder is made where it is missing. Raises RecordingError where it cannot be written."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(html, encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{path}: the report cannot be written: {error.strerror}; free space or give another folder") from error
    return path


def _template(name: str, **values: Any) -> str:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"number": number, "signed": signed, "shape_title": shape_title}
    kept = {key: Markup((HERE / file).read_text(encoding="utf-8")) for key, file in (("css", "page.css"), ("js", "page.js"))}
    return environment.get_template(name).render(plotly=Markup(get_plotlyjs()), **kept, **values)


def number(value: float | None, digits: int = 3) -> str:
    """Fixed point with a typographic minus; a dash where there is no value."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.{digits}f}".replace("-", "−")


def signed(value: float | None, digits: int = 3) -> str:
    text = number(value, digits)
    return text if text in "–" or text.startswith("−") else f"+{text}"


def shape_title(effect: str, at: str) -> str:
    return f"{'Effect without a name' if effect == 'unknown' else readable(effect).capitalize()} at {at}"


def _figures(content: Content) -> dict[str, Any]:
    from mbcacq.report.charts import calibration_charts, more_charts

    figures: dict[str, Any] = {}
    if content.spacing is not None:
        figures["spacing"] = calibration_charts.spacing(content.spacing)
    if (data := content.residuals) is not None and len(data.xyz):
        figures["pose"] = calibration_charts.residual_per_pose(data)
        data = data.used()
        figures |= {"ball": calibration_charts.residual_per_ball(data), "ball_mean": calibration_charts.residual_mean_per_ball(data)}
        if data.station is not None:
            figures["station"] = more_charts.residual_per_station(data)
        if data.q_deg is not None:
            figures |= {f"axis_{i}": more_charts.residual_over_axis(data, i) for i in range(data.q_deg.shape[1])}
        if data.weighted is not None:
            figures["histogram"] = calibration_charts.histogram(data)
    if content.spheres is not None:
        figures |= {"sphere_rms": more_charts.sphere_quality(content.spheres), "sphere_points": more_charts.sphere_points(content.spheres)}
    if content.correlation is not None and len(content.correlation[0]) > 1:
        figures["correlation"] = calibration_charts.correlation(*content.correlation)
    if content.accuracy is not None:
        figures |= {"accuracy_top": more_charts.accuracy(content.accuracy, 1), "accuracy_side": more_charts.accuracy(content.accuracy, 2)}
    if content.coverage is not None and len(content.coverage.q_deg):
        figures["joints"] = calibration_charts.joint_coverage(content.coverage)
        draw = calibration_charts.ball_coverage if content.coverage.balls is not None else calibration_charts.place_coverage
        if content.coverage.flange is not None:
            figures |= {"places_top": draw(content.coverage, 1), "places_side": draw(content.coverage, 2)}
    figures |= _of_devices(content)
    return {name: _div(name, figure) for name, figure in figures.items()}


def _of_devices(content: Content) -> dict[str, Any]:
    from mbcacq.report.charts import more_charts

    out: dict[str, Any] = {}
    if (devices := content.devices) is None:
        return out
    if devices.state_s:
        out["states"] = more_charts.time_spent(devices)
    for name, data, draw in (
        ("late", devices.late, more_charts.late_answers),
        ("period", devices.period_ms, more_charts.periods),
        ("exposure", devices.exposure_s, more_charts.exposure_times),
    ):
        if data is not None and len(data) and (name != "late" or data.any()):
            out[name] = draw(devices)
    return out


def _of_diagnosis(told: DiagnosisContent) -> dict[str, Any]:
    from mbcacq.report.charts import diagnosis_charts

    figures: dict[str, Any] = {} if told.map is None else {"map": diagnosis_charts.heat_map(told)}
    figures |= {f"shape_{k}": diagnosis_charts.shape(curve) for k, curve in enumerate(told.curves)}
    figures |= {f"along_{k}": diagnosis_charts.along(told, cause) for k, cause in enumerate(told.causes)} if told.centres else {}
    return {name: _div(name, figure) for name, figure in figures.items()}


def _div(name: str, figure: Any) -> Any:
    """The figure as data beside its place: drawn by page.js. What could end a script element is written as an escape."""
    from markupsafe import Markup

    data = figure.to_json().replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    height = figure.layout.height or 300
    return Markup(
        f'<div class="plot" id="figure-{name}" data-figure="data-{name}" style="height:{height:g}px"></div>'
        f'<script type="application/json" id="data-{name}">{data}</script>'
    )
