"""The page in a real browser (headless Chromium): draws everything, asks for nothing, fits a desk and a phone, and prints."""

import numpy as np
import pytest
from chromium import Browser, program
from made_up import devices, diagnosis, motion, pictures
from result_page import make_observations, make_result

from mbcacq.diagnosis.result import Diagnosis
from mbcacq.report.write import report_from_result, write_diagnosis_page

pytestmark = pytest.mark.skipif(program() is None, reason="no Chromium is installed (apt-get install chromium)")

TOO_WIDE = """Array.from(document.querySelectorAll('main *'))
  .filter(e => !e.closest('svg') && !e.closest('.scroll') && !e.closest('pre') && !e.closest('details:not([open])'))
  .filter(e => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map(e => e.tagName + ' ' + e.className)"""
EMPTY = """Array.from(document.querySelectorAll('.plot')).filter(p => !p.querySelector('.main-svg .plot *, .main-svg .cartesianlayer *')).map(p => p.id)"""
UNLABELLED = """Array.from(document.querySelectorAll('.plot')).filter(p => Object.keys(p.layout).filter(k => /^[xy]axis/.test(k))
  .some(k => p.layout[k].visible !== false && p.layout[k].showticklabels !== false && !((p.layout[k].title || {}).text || '').trim())).map(p => p.id)"""
# what plotly draws outside of its own frame is cut off there
CUT_OFF = """Array.from(document.querySelectorAll('.plot')).flatMap(p => { const f = p.getBoundingClientRect();
  return Array.from(p.querySelectorAll('.main-svg text')).filter(t => t.textContent.trim()).filter(t => { const r = t.getBoundingClientRect();
  return r.width && (r.left < f.left - 1 || r.right > f.right + 1 || r.top < f.top - 1 || r.bottom > f.bottom + 1); })
  .map(t => p.id + ': ' + t.textContent); })"""


@pytest.fixture(scope="module")
def whole_page(tmp_path_factory):
    """Everything that a report can hold."""
    result = make_result()
    grid = np.stack(np.meshgrid(*[np.arange(-1000, 1001, 250.0)] * 3), axis=-1).reshape(-1, 3)
    result["accuracy_map"] = {
        "cell_mm": 250.0,
        "centres_mm": grid.tolist(),
        "sigma_mm": (1e-5 * np.linalg.norm(grid, axis=1)).tolist(),
        "postures": [1] * len(grid),
    }
    obs = make_observations()
    info = {
        "name": "cell 7",
        "started": "2026-11-21T07:45:48+00:00",
        "folder": "runs/today",
        "diagnosis": diagnosis(),
        "pictures": pictures(),
        "devices": devices(),
        "hashes": [("run.rrd", "1 234", "0" * 64)],
        "versions": {"numpy": "2.4.6"},
        "plan_yaml": "format: mbcacq-plan/1\n" + "x" * 300,
    }
    from dataclasses import replace

    rng = np.random.default_rng(1)
    obs = replace(obs, n_points=rng.integers(800, 1600, obs.n_centres).astype(float), rms_mm=rng.uniform(0.010, 0.012, obs.n_centres))
    return report_from_result(result, path=tmp_path_factory.mktemp("page") / "report.html", observations=obs, run_info=info)


@pytest.fixture(scope="module")
def diagnosis_page(tmp_path_factory):
    """A diagnosis of poses and of the motion between them."""
    return write_diagnosis_page(
        Diagnosis.from_json(diagnosis()), pictures(), tmp_path_factory.mktemp("page") / "diagnosis.html", motion=motion()
    )


DESK, PHONE = (1280, 900, False), (390, 844, True)


@pytest.fixture(scope="module")
def shown(request):
    """shown("whole_page", DESK): a browser that shows a page. It stays open until another is asked for: drawing takes most of the time."""
    last = {}

    def show(page, screen):
        if (page, screen) not in last:
            end()
            browser = last[page, screen] = Browser(*screen)
            browser.open(request.getfixturevalue(page))
        return last[page, screen]

    def end():
        for browser in last.values():
            browser.__exit__()
        last.clear()

    yield show
    end()


@pytest.mark.parametrize(
    ("page", "plots", "screen"),
    [("diagnosis_page", 18, PHONE), ("diagnosis_page", 18, DESK), ("whole_page", 22, PHONE), ("whole_page", 22, DESK)],
    ids=["diagnosis on a phone", "diagnosis on a desk", "whole page on a phone", "whole page on a desk"],
)
def test_everything_is_drawn_and_nothing_is_requested(shown, page, plots, screen):
    browser = shown(page, screen)
    assert browser.console == []
    assert [r for r in browser.requests if not r.startswith(("file:", "data:", "blob:"))] == []
    assert browser.run("document.querySelectorAll('.plot').length") >= plots
    assert browser.run(EMPTY) == []
    assert browser.run(UNLABELLED) == []
    assert browser.run(CUT_OFF) == []
    assert browser.run(TOO_WIDE) == []
    assert browser.run("document.documentElement.scrollWidth") <= screen[0]


def test_verdict_picture_and_next_action_are_on_the_first_screen(shown):
    browser = shown("whole_page", DESK)
    for part in (".verdict", ".picture", ".next", "dl.numbers"):
        assert browser.run(f"document.querySelector('{part}').getBoundingClientRect().bottom") < 900, part


def test_it_prints_with_every_figure_at_the_width_of_the_paper(shown, tmp_path):
    browser = shown("whole_page", DESK)
    browser.pdf(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes()[:5] == b"%PDF-"
    browser.run("window.dispatchEvent(new Event('beforeprint'))")
    drawn = "Array.from(document.querySelectorAll('.plot')).map(p => p.querySelector('.main-svg').getBoundingClientRect().width)"
    assert browser.run(f"Math.max(...{drawn})") <= 671
    assert browser.console == []


SHADES = """((page) => [page, document.querySelector('h1')].map((e) => getComputedStyle(e))
  .flatMap((style, k) => (k ? style.color : style.backgroundColor).match(/\\d+/g).slice(0, 3).map(Number))
  .concat(getComputedStyle(document.querySelector('.plot')).filter !== 'none'))(document.querySelector('main'))"""


@pytest.mark.parametrize("page", ["whole_page", "fleet_page"])
def test_a_dark_desk_gets_a_dark_page_with_figures_turned_light_and_paper_stays_white(shown, page):
    browser = shown(page, DESK)
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    browser.call("Emulation.setEmulatedMedia", features=dark)
    *ground, red, green, blue, turned = browser.run(SHADES)
    assert max(ground) < 60
    assert min(red, green, blue) > 200
    assert turned
    browser.call("Emulation.setEmulatedMedia", media="print", features=dark)
    *ground, red, green, blue, turned = browser.run(SHADES)
    assert ground == [255, 255, 255]
    assert max(red, green, blue) < 60
    assert not turned
    assert browser.console == []
    browser.call("Emulation.setEmulatedMedia", media="", features=[])


@pytest.fixture(scope="module")
def fleet_page(tmp_path_factory):
    """Three arms, each measured on five days; one drifts. Nothing of it was measured on a real arm."""
    from mbcacq.fleet.control_chart import arm_types, outliers
    from mbcacq.fleet.page import fleet_content
    from mbcacq.fleet.row import FleetRow
    from mbcacq.report.page import render_fleet

    rows = [
        FleetRow(
            recording=f"runs/{a}/day-{k}", arm=f"welding cell {a}", time=f"2026-0{k + 1}-03T10:00:00+00:00", status="evaluated",
            robot="R", nominal=(0.0,) * 30, estimates={"theta_2": (1e-4 * k * (a == 1) + 1e-6 * a, 1e-5)}, simulated=True,
            names=("theta_2",), covariance=(1e-10,), poses=96, rms_mm=0.0093, spacing_max_mm=0.022,
        )
        for a in range(3)
        for k in range(5)
    ]  # fmt: skip
    kinds = arm_types(rows)
    path = tmp_path_factory.mktemp("fleet") / "fleet.html"
    path.write_text(render_fleet(fleet_content(rows, kinds, outliers(kinds)), "Fleet"), encoding="utf-8")
    return path


@pytest.mark.parametrize("screen", [DESK, PHONE], ids=["desk", "phone"])
def test_the_page_of_a_fleet_is_uncut_names_its_lines_and_has_dates(shown, screen):
    browser = shown("fleet_page", screen)
    assert browser.console == []
    assert browser.run(TOO_WIDE) == []
    assert browser.run(CUT_OFF) == []
    drawn = browser.run("Array.from(document.querySelectorAll('[id*=drift_0] text')).map(t => t.textContent)")
    assert "welding cell 1" in drawn
    assert any("2026-0" in text for text in drawn)
    listed = browser.run("document.getElementById('recordings').nextElementSibling.querySelectorAll('tr').length")
    assert listed == 16
    assert "simulated" in browser.run("document.querySelector('.caveat').textContent")


def test_the_view_that_turns_is_turned_by_keys(whole_page):
    picture = "document.getElementById('scene').toDataURL()"
    with Browser() as browser:
        browser.open(whole_page)
        browser.run("document.getElementById('scene').focus()")
        assert browser.run("document.activeElement.id") == "scene"
        before = browser.run(picture)
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight", windowsVirtualKeyCode=39)
        turned = browser.run(picture)
        assert turned != before
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowLeft", code="ArrowLeft", windowsVirtualKeyCode=37)
        assert browser.run(picture) == before


def test_before_and_after_are_moved_by_keys_and_stand_one_under_the_other_on_paper(whole_page):
    tops = "Array.from(document.querySelectorAll('.slide figure')).map((figure) => Math.round(figure.getBoundingClientRect().top))"
    with Browser() as browser:
        browser.open(whole_page)
        browser.run("document.querySelector('.slide input').focus()")
        assert len(set(browser.run(tops))) == 1
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="End", code="End", windowsVirtualKeyCode=35)
        assert "left 100 %" in browser.run("document.activeElement.getAttribute('aria-valuetext')")
        assert browser.run("getComputedStyle(document.querySelector('.slide figure')).clipPath") in (
            "inset(0px)",
            "inset(0px 0%)",
            "inset(0px 0% 0px 0px)",
        )
        browser.call("Emulation.setEmulatedMedia", media="print")
        before, after = browser.run(tops)
        assert after > before + 100
