"""A whole plan over GoPxL: one word in the plan changes the scanner's protocol."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mbcacq_gocator.driver import Gocator

from mbcacq.cli.app import app
from mbcacq.devices import ConnectError, load_driver
from mbcacq.plan import expand, load
from mbcacq.recording import load_observations
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import Recording
from mbcacq.workflow import acquire

PLANS = Path(__file__).parents[2] / "plans"


def over_gopxl(folder, name):
    """A shipped plan with that one word changed."""
    text = (PLANS / name).read_text(encoding="utf-8")
    assert text.count("driver: gocator") == 1
    for part in ("robots", "artefacts"):
        (folder / part).symlink_to(PLANS / part)
    plan = folder / name
    plan.write_text(text.replace("driver: gocator", "driver: gopxl"), encoding="utf-8")
    return plan


def test_poses_of_every_phase_of_the_published_plan_are_measured_over_gopxl(tmp_path):
    """The first of each phase; the whole plan differs only in their number."""
    loaded = load(over_gopxl(tmp_path, "kuka.yaml"))
    phases = ("translation", "orientation", "position", "verification")
    poses = [next(p for p in expand(loaded) if p.phase == phase) for phase in phases]
    run = acquire.plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell of seed 0")
    run.folder = acquire.new_run_folder(tmp_path / "run", "kuka")
    with load_driver("fakes", "cell")(loaded, poses, seed=0) as cell:
        run.execute(cell.overrides())
    observations = load_observations(run.folder)
    assert set(observations.pose_id.tolist()) == {p.number for p in poses}
    assert {observations.cell.ball_ids[b] for b in observations.ball} > set(range(1, 9))  # and a ball of the bar


def test_sweeps_are_recorded_over_gopxl_with_every_profile_and_its_time(tmp_path):
    loaded = load(over_gopxl(tmp_path, "profiler.yaml"))
    poses = expand(loaded)[:2]
    run = acquire.plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell of seed 0")
    run.folder = acquire.new_run_folder(tmp_path / "run", "profiler")
    with load_driver("fakes", "cell")(loaded, poses, seed=0) as cell:
        run.execute(cell.overrides())
    sweeps = [row for row in Recording(run.folder / layout.RUN_FILE).rows(layout.SWEEP) if "points" in row]
    assert len(sweeps) == 2
    for row in sweeps:
        assert int(row["lost"][0]) == 0
        jitter = row["time_s"] - row["time_s"][0] - (row["counter"] - row["counter"][0]) / 60  # 0.1 ms, as the plan says
        assert np.ptp(row["counter"]) > 60
        assert np.abs(jitter).max() < 1e-3


def test_the_quick_plan_runs_dry_with_gopxl_by_one_word(tmp_path):
    plan = over_gopxl(tmp_path, "quick.yaml")
    done = CliRunner().invoke(app, ["run", str(plan), "--dry-run", "--out", str(tmp_path / "run"), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout.splitlines()[-1])
    assert max(result["noise"]["scanner_mm"]) < 0.02  # of the centres; the arm, which one station leaves nominal, is worse


def test_the_classic_driver_names_gopxl_where_that_answers(sensor, monkeypatch):
    monkeypatch.setattr("mbcacq_gocator.driver.GOPXL_CONTROL", sensor.ports.control)
    with pytest.raises(ConnectError, match="use driver: gopxl"):
        Gocator("scanner", "", {"address": "127.0.0.1", "control_port": 1, "connect_timeout_s": 0.5}).connect()
