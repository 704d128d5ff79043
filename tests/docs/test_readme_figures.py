"""The figures that the README states of its own dry runs are those that its commands come to, to the digits that matter."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from doc_pages import ROOT

import mbcacq
from mbcacq.calibration.verification import verification_poses
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.cli.app import app
from mbcacq.plan import expand, load
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import Recording

sys.path.insert(0, str(ROOT / "docs" / "_make"))

from printed import same  # noqa: E402

README = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())


def stated(pattern: str) -> str:
    """The number that the README gives in a sentence."""
    found = re.search(pattern, README)
    assert found, f"README.md no longer says '{pattern}'"
    return found[1]


def bar(folder: Path, when: str = "after") -> float:
    """Mean error of the bar, mm."""
    return json.loads((folder / "result.json").read_text())["verification"][when]["mean_mm"]


def test_before_with_the_run_and_with_its_effects(concealed_run):
    measured, diagnosed = concealed_run
    assert same(stated(r"The error of the bar is ([\d.]+) mm in the mean before"), f"{bar(measured.folder, 'before'):.3f}")
    assert bar(measured.folder) < float(stated(r"The run itself ends below ([\d.]+) mm"))
    learnt = Recording(measured.folder / "result.rrd").scalars(f"{layout.RMS_POSE}/after")[f"/{layout.RMS_POSE}/after"]
    assert np.median(learnt) < 30  # um; the noise is 13, and geometry alone leaves 200
    assert bar(diagnosed.folder / "with-effects") < float(stated(r"they leave less than ([\d.]+) mm"))
    assert "What next: calibrate" not in diagnosed.stdout + diagnosed.stderr  # it was done just now
    shown = Recording(diagnosed.folder / "result.rrd")
    assert "without the effects" in shown.text(layout.VERDICT)
    assert np.median(shown.scalars(f"{layout.RMS_POSE}/after")[f"/{layout.RMS_POSE}/after"]) < 30  # um; the noise is 13


def test_with_the_geometry_alone(concealed_run, tmp_path):
    done = CliRunner().invoke(app, ["calibrate", str(concealed_run[0].folder), "--geometry-alone", "--out", str(tmp_path / "result.json")])
    assert done.exit_code == 0, done.output
    assert same(stated(r"and ([\d.]+) mm after a calibration of the geometry alone"), f"{bar(tmp_path):.3f}")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_published_plan(seed):
    """Computed without protocols, whose centres agree with those of rendered frames (tests/fake_effects)."""
    loaded = load(ROOT / "plans" / "paper.yaml")
    measured, _ = observe(loaded, expand(loaded), Scenario(0, "none", seed, (), seed, 1.0), [])
    cell = mbcacq.calibrate(measured.select(measured.phase != "verification"))
    ends = np.abs(mbcacq.verify(verification_poses(measured), cell).errors("after")).mean()
    assert ends < float(stated(r"the same plan \(`plans/paper.yaml`\) ends below ([\d.]+) mm in the mean"))
