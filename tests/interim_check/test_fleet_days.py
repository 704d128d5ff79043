"""What the arms of a fleet change from day to day is what their table says, and a check takes it from there."""

import json

import numpy as np
import pyarrow
import pytest
from check_cells import simulated_plan
from click.testing import CliRunner
from pyarrow import parquet

import mbcacq
from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.interim_check.day_to_day import read_day_to_day
from mbcacq.interim_check.history import read_history
from mbcacq.interim_check.options import UsualChanges

DAYS = {"theta": 4e-5, "x": 0.006, "rx": 2e-5}  # rad, mm, rad: standard deviations from day to day
STATED = 1e-5  # of each figure of a recording


def fleet_table(folder, robot, recordings=24):
    """Three arms, each with errors of its own, that change from one recording to the next."""
    rng, rows = np.random.default_rng(8), []
    for arm in range(3):
        own = rng.normal(0.0, 1e-3, 12)
        for day in range(recordings):
            row = {"recording": f"{arm}-{day}", "arm": f"arm {arm}", "time": f"2026-01-{day + 1:02d}T08:00:00", "robot": robot}
            row |= {
                "status": "evaluated",
                "names": [f"theta_{i + 1}" for i in range(6)],
                "covariance": (STATED**2 * np.eye(6)).ravel().tolist(),
                "nominal": [0.0] * 30,
            }
            names = [f"theta_{i + 1}" for i in range(6)] + [f"hand_eye.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")]
            sigma = [DAYS["theta"]] * 6 + [DAYS["x"]] * 3 + [DAYS["rx"]] * 3
            for k, name in enumerate(names):
                row[f"error.{name}"] = own[k] + rng.normal(0.0, np.hypot(sigma[k], STATED))
                row[f"std.{name}"] = STATED
            rows.append(row)
    parquet.write_table(pyarrow.Table.from_pylist(rows), folder / "fleet.parquet")
    return folder


def test_days_of_a_fleet_scatter_as_its_arms_do_whatever_each_arm_is_off_by(tmp_path):
    found = read_day_to_day(fleet_table(tmp_path, "some arm"), "some arm")
    assert found.joint == pytest.approx(DAYS["theta"], rel=0.25)
    assert found.mount_mm == pytest.approx(DAYS["x"], rel=0.25)
    assert found.mount_rad == pytest.approx(DAYS["rx"], rel=0.35)
    assert found.station_mm == UsualChanges().station_mm
    assert "72 recordings of 3 arms" in found.source


def test_a_fleet_without_recordings_of_this_arm_says_nothing_of_its_days(tmp_path):
    with pytest.raises(ConfigError, match="too few arms of type 'another arm'"):
        read_day_to_day(fleet_table(tmp_path, "some arm", recordings=5), "another arm")


def test_a_check_takes_the_days_of_the_fleet_and_keeps_them(learnt, tmp_path):
    plan = simulated_plan(tmp_path)
    fleet = fleet_table(tmp_path, mbcacq.load_plan(plan).cell.robot.name)
    given = ["check", str(learnt), str(plan), "--dry-run", "--seed", "3", "--poses", "6", "--fleet", str(fleet), "--json"]
    done = CliRunner().invoke(app, [*given, "--history", str(tmp_path / "check.json"), "--out", str(tmp_path / "day")])
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["verdict"] == "as_before"
    kept = read_history(tmp_path / "check.json").usual_days
    assert kept == read_day_to_day(fleet, mbcacq.load_plan(plan).cell.robot.name)
    assert "3 arms" in kept.source
