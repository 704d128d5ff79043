"""A whole plan over GoPxL: one word in the plan changes the scanner's protocol."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from mbcacq_gocator import generation
from mbcacq_gocator.driver import Gocator

from mbcacq.cli.app import app
from mbcacq.devices import ConnectError

PLANS = Path(__file__).parents[2] / "plans"


def test_the_quick_plan_runs_dry_with_gopxl_by_one_word(tmp_path):
    text = (PLANS / "quick.yaml").read_text(encoding="utf-8")
    assert text.count("driver: gocator") == 1
    for name in ("robots", "artefacts"):
        (tmp_path / name).symlink_to(PLANS / name)
    plan = tmp_path / "quick.yaml"
    plan.write_text(text.replace("driver: gocator", "driver: gopxl"), encoding="utf-8")
    done = CliRunner().invoke(app, ["run", str(plan), "--dry-run", "--out", str(tmp_path / "run"), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout.splitlines()[-1])
    assert max(result["noise"]["scanner_mm"]) < 0.02  # of the centres; the arm, which one station leaves nominal, is worse


def test_the_classic_driver_names_gopxl_where_that_answers(sensor, monkeypatch):
    monkeypatch.setattr(generation, "GOPXL_CONTROL", sensor.ports.control)
    with pytest.raises(ConnectError, match="use driver: gopxl"):
        Gocator("scanner", "", {"address": "127.0.0.1", "control_port": 1, "connect_timeout_s": 0.5, "retries": 0}).connect()
