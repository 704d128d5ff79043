"""The documentation is complete and true to the code: the site builds without a warning, generated pages are current."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import time

import pytest
from chromium import Browser, program
from doc_pages import ROOT

import mbcacq
from mbcacq.cli.app import COMMANDS

MAKE = ROOT / "docs" / "_make"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """(the folder of the site, what building it said)"""
    site = tmp_path_factory.mktemp("documentation") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},  # a banner of the theme, about the future of mkdocs
    )
    assert done.returncode == 0, done.stderr
    return site, done.stderr


def test_site_builds_without_warnings_and_asks_nothing_of_other_hosts(built):
    site, said = built
    assert "WARNING" not in said
    assert (site / "index.html").exists()
    python = (site / "reference" / "python.html").read_text(encoding="utf-8")
    assert [name for name in mbcacq.__all__ if not name.startswith("_") and f'id="mbcacq.{name}"' not in python] == []
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for tag in ('<script src="http', '<link rel="stylesheet" href="http', '<img src="http', "fonts.googleapis"):
            assert tag not in text, f"{page.name}: {tag}"


@pytest.mark.skipif(program() is None, reason="no Chromium is installed (apt-get install chromium)")
def test_the_search_finds_pages_when_the_site_is_opened_from_a_folder(built):
    with Browser() as browser:
        browser.open(built[0] / "diagnosis.html", "document.readyState === 'complete'")
        browser.run(
            "document.querySelector('#__search').click(); const field = document.querySelector('.md-search__input');"
            "field.value = 'hand-eye'; field.dispatchEvent(new KeyboardEvent('keyup', {bubbles: true}));"
        )
        deadline = time.monotonic() + 600.0
        while not browser.run("document.querySelectorAll('.md-search-result__item').length") and time.monotonic() < deadline:
            time.sleep(0.1)
        assert browser.run("document.querySelectorAll('.md-search-result__item').length") > 5
        assert [request for request in browser.requests if request.startswith("http")] == []


def test_the_reference_of_the_site_is_made_from_the_code(built):
    reference = built[0] / "reference"
    said = (reference / "command-line.html").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"mbcacq {name}" not in said] == []
    assert "workspace" in (reference / "plan-schema.html").read_text(encoding="utf-8")
    assert "ConfigError" in (reference / "errors.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("script", ["architecture_figure", "diagnosis_figure"])
def test_pictures_that_scripts_draw_are_current(script, monkeypatch):
    monkeypatch.syspath_prepend(str(MAKE))
    figure = importlib.import_module(script)
    assert figure.TARGET.read_text(encoding="utf-8") == figure.draw(), f"run python docs/_make/{script}.py"
