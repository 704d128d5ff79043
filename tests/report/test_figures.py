"""Figures are data: what plotly.js understands, in the numbers that were given, without Plotly for Python."""

import json
from base64 import b64decode

import numpy as np
import plotly.graph_objects as go
import pytest
from chromium import Browser, program
from made_up import diagnosis, motion, pictures
from result_page import make_observations, make_result

import mbcacq.figure
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.errors import ConfigError
from mbcacq.figure import Figure, drawing_library
from mbcacq.report.figures import diagnosis_figures, report_figures
from mbcacq.report.sources.from_diagnosis import diagnosis_content
from mbcacq.report.sources.from_motion import motion_content
from mbcacq.report.sources.from_result import content_of


def test_plotly_knows_every_property_of_every_figure():
    """Plotly for Python refuses what plotly.js would pass over in silence."""
    figures = report_figures(content_of(make_result(), make_observations(), {}))
    figures |= diagnosis_figures(diagnosis_content(Diagnosis.from_json(diagnosis()), pictures())) | diagnosis_figures(
        motion_content(motion())
    )
    assert len(figures) > 20
    for figure in figures.values():
        assert len(go.Figure(figure.to_dict()).data) == len(figure.data)


def test_arrays_come_through_bit_for_bit():
    values = np.array([0.1, -3.0, np.nan, 1e300])
    counts = np.array([[1, -70000], [3, 2**31 - 1]])
    figure = Figure().add_scatter(x=values, y=counts, text=np.array(["a", "b"]), customdata=[np.int64(7), float("nan")])
    sent = json.loads(figure.to_json())["data"][0]
    read = go.Figure(figure.to_dict()).data[0]
    np.testing.assert_array_equal(np.frombuffer(b64decode(sent["x"]["bdata"]), sent["x"]["dtype"]), values)
    np.testing.assert_array_equal(read.y, counts)
    assert sent["y"]["shape"] == "2, 2"
    assert (sent["text"], sent["customdata"]) == (["a", "b"], [7, None])


def test_titles_may_be_plain_and_axes_keep_what_was_set_before():
    figure = Figure(layout={"xaxis2": {"anchor": "y2"}})
    figure.update_xaxes(title="time / s", type="log")
    figure.update_xaxes(showgrid=False)
    assert figure.layout["xaxis2"] == {"anchor": "y2", "title": {"text": "time / s"}, "type": "log", "showgrid": False}
    assert figure.layout["yaxis"] == {}


@pytest.mark.skipif(program() is None, reason="no Chromium is installed (apt-get install chromium)")
def test_two_figures_of_a_notebook_draw_themselves_with_one_library(tmp_path):
    """The second one comes where the library is there already; nothing is fetched."""
    first = Figure(layout={"height": 300}).add_scatter(x=np.arange(4.0), y=np.arange(4.0) ** 2, mode="lines", name="</script>")
    second = Figure().add_bar(x=["a", "b"], y=np.array([1, 2]))
    page = first.to_html().replace("</body>", second._repr_html_() + "</body>")
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    with Browser() as browser:
        browser.open(tmp_path / "page.html", drawn="document.querySelectorAll('.main-svg .trace, .main-svg .point').length >= 3")
        assert browser.console == []
        assert [r for r in browser.requests if not r.startswith(("file:", "data:", "blob:"))] == []
    assert first._repr_mimebundle_()["text/plain"] == "Figure of 1 traces"


def test_a_package_that_was_not_built_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(mbcacq.figure, "LIBRARY", tmp_path / "plotly.min.js")
    with pytest.raises(ConfigError, match="is missing, which draws the figures; install mbcacq with pip"):
        drawing_library()
