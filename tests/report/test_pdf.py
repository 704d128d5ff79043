"""The report on paper: the same verdict and figures as on the page, A4, every picture in it, and nothing fetched."""

import re
import zlib

import numpy as np
import pytest
from click.testing import CliRunner
from result_page import make_observations, make_result

from mbcacq.cli.report import command
from mbcacq.errors import ConfigError
from mbcacq.figure import Figure
from mbcacq.report.charts.static_svg import static_svg
from mbcacq.report.write import report_from_result


@pytest.fixture(scope="module")
def pdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("paper") / "report.pdf"
    return report_from_result(make_result(), path=path, observations=make_observations()).read_bytes()


def streams(pdf):
    for data in re.findall(rb"stream\r?\n(.*?)endstream", pdf, re.DOTALL):
        try:
            yield zlib.decompress(data)
        except zlib.error:
            yield data


def test_it_is_a4_and_of_few_pages(pdf):
    whole = b"\n".join([pdf, *streams(pdf)])
    sizes = {tuple(round(float(v)) for v in box.split()) for box in re.findall(rb"/MediaBox\s*\[([^\]]+)\]", whole)}
    assert sizes == {(0, 0, 595, 842)}
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", whole)) <= 12


def test_pictures_are_drawn_and_not_referred_to(pdf):
    drawn = b"".join(streams(pdf))
    assert drawn.count(b" c\n") + drawn.count(b" c ") > 500  # curves of marks and characters in the figures
    assert b"http" not in pdf


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_bar_is_as_long_as_its_value(axis):
    """The outlines of two bars, 1 and 3, in the drawing."""
    bar = {"x": ["a", "b"], "y": [1.0, 3.0]} if axis == "y" else {"y": ["a", "b"], "x": [1.0, 3.0], "orientation": "h"}
    svg = static_svg(Figure(layout={"height": 300}).add_bar(marker={"color": "#123456"}, **bar), 400)
    paths = re.findall(r'<path d="([^"]+)"[^>]*style="fill: #123456', svg)
    corners = [np.array([[float(v) for v in pair] for pair in re.findall(r"[ML] ([-\d.]+) ([-\d.]+)", path)]) for path in paths]
    lengths = [np.ptp(c[:, 1 if axis == "y" else 0]) for c in corners]
    assert lengths[1] / lengths[0] == pytest.approx(3.0, rel=1e-3)


def test_grouped_bars_stand_beside_each_other():
    svg = static_svg(Figure({"type": "bar", "x": ["a"], "y": [1.0], "marker": {"color": c}} for c in ("#111111", "#222222")), 400)
    spans = []
    for colour in ("#111111", "#222222"):
        (path,) = re.findall(rf'<path d="([^"]+)"[^>]*style="fill: {colour}', svg)
        x = [float(v) for v in re.findall(r"[ML] ([-\d.]+)", path)]
        spans.append((min(x), max(x)))
    assert spans[0][1] <= spans[1][0] + 0.01


def test_an_out_that_is_no_pdf_is_refused(tmp_path):
    outcome = CliRunner().invoke(command, [str(tmp_path), "--pdf", "--out", str(tmp_path / "report.html")])
    assert isinstance(outcome.exception, ConfigError)
    assert "does not end in .pdf" in str(outcome.exception)


def test_a_colour_bar_says_the_same_numbers_as_on_the_screen():
    """The evidence is coloured by the logarithm of what its bar says."""
    scale = {"tickvals": [0.0, 1.0, 2.0], "ticktext": ["0", "9", "99"]}
    svg = static_svg(Figure().add("heatmap", z=[[0.0, 2.0]], colorscale=[[0, "#000000"], [1, "#ffffff"]], colorbar=scale), 400)
    said = re.findall(r"<!-- ([^ ]+) -->", svg)  # characters are outlines, each group of them behind its text
    assert said.count("9") == said.count("99") == 1
    assert "2.0" not in said


def test_names_of_horizontal_bars_stand_at_the_bars_and_numbers_below_them():
    svg = static_svg(Figure().add_bar(y=["run"], x=[30.0], orientation="h"), 400)
    said = re.findall(r"<!-- ([^ ]+) -->", svg)
    assert "run" in said
    assert "10" in said


def test_the_band_of_a_curve_is_filled_on_paper_too():
    """Between 1 and 3 over the whole width, in the colour and with the opacity of the screen."""
    band = {"x": [0.0, 1.0, 1.0, 0.0], "y": [1.0, 1.0, 3.0, 3.0], "fill": "toself", "fillcolor": "rgba(255,0,0,0.25)", "line": {"width": 0}}
    figure = Figure().add_scatter(x=[0.0, 1.0], y=[0.0, 4.0], mode="lines").add_scatter(mode="lines", **band)
    (path,) = re.findall(r'<path d="([^"]+)"[^>]*style="fill: #ff0000; fill-opacity: 0.25', static_svg(figure, 400))
    height = np.ptp([float(y) for y in re.findall(r"[ML] [-\d.]+ ([-\d.]+)", path)])
    whole = static_svg(Figure().add_bar(x=["a"], y=[4.0], marker={"color": "#123456"}), 400)
    assert height > 0.3 * np.ptp(
        [float(y) for y in re.findall(r"[ML] [-\d.]+ ([-\d.]+)", re.findall(r'd="([^"]+)"[^>]*style="fill: #123456', whole)[0])]
    )
