"""A session without drivers gives the calibration that a driven run of the same cell gives, and grows where clouds are added."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import killed_session
import numpy as np
import pytest
from session import cloud, loaded, play, program_of

import mbcacq
from mbcacq.devices import ConfigError
from mbcacq.recording.run_folder.progress import poses_done


def hand_eye(result):
    return np.array(result.content["T_flange_scanner"])


def test_it_gives_what_a_driven_run_gives(rehearsed, tmp_path):
    """The same cell (seed 0): only the noise of the scans and of the arm differs."""
    plan = loaded(rehearsed / "plan.yaml")
    heard = []
    sources = mbcacq.Sources(rehearsed / "clouds", joints=rehearsed / "clouds-joints.csv")
    collected = mbcacq.collect(plan, sources, out=tmp_path / "a", operator=mbcacq.Operator(subscribers=(heard.append,)))
    driven = mbcacq.run(plan, dry_run=True, out=tmp_path / "b")
    away = np.linalg.inv(hand_eye(driven)) @ hand_eye(collected)
    assert np.linalg.norm(away[:3, 3]) < 0.25  # three combined standard uncertainties of a hand-eye that an uncalibrated arm leaves open
    assert np.linalg.norm(away[:3, :3] - np.eye(3)) < 1.2e-3
    assert mbcacq.load_observations(collected.folder).n_poses == 16
    assert heard[0].simulated, "the clouds say that no real scanner made them"
    assert "simulated" in (collected.folder / "report.html").read_text(encoding="utf-8")


def test_clouds_are_added_to_a_session_that_was_stopped(rehearsed, clouds, tmp_path):
    plan = loaded(rehearsed / "plan.yaml")
    for k in range(12, 17):
        cloud(clouds, k).unlink()
    first = mbcacq.collect(plan, clouds, out=tmp_path / "run")
    assert poses_done(first.folder) == frozenset(range(11))
    rest = program_of(rehearsed / "plan.yaml", tmp_path / "rest", done=frozenset(range(11)))
    more = play(rehearsed / "plan.yaml", rest, tmp_path / "more")
    assert len(list(more.glob("*.ply"))) == 5
    shutil.copy(rest / "poses.csv", more)
    whole = mbcacq.collect(plan, more, resume=first.folder)
    assert poses_done(whole.folder) == frozenset(range(16))
    assert mbcacq.load_observations(whole.folder).n_poses == 16


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL is of other systems")
def test_a_session_that_was_killed_goes_on_with_the_same_clouds(rehearsed, collected, clouds, tmp_path):
    """No table of the program stands beside them: which of them were recorded is seen by what they show."""
    plan = loaded(rehearsed / "plan.yaml")
    (clouds / "poses.csv").unlink(missing_ok=True)
    whole = mbcacq.load_observations(collected(False) / "run")
    script = [sys.executable, killed_session.__file__, rehearsed / "plan.yaml", clouds, tmp_path / "run", "5"]
    assert subprocess.run(script, timeout=900, check=False).returncode == -signal.SIGKILL
    again = mbcacq.load_observations(mbcacq.collect(plan, clouds, resume=tmp_path / "run").folder)
    assert np.array_equal(again.pose_id, whole.pose_id)
    assert np.array_equal(again.xyz, whole.xyz)


@pytest.mark.parametrize(("with_table", "missing"), [(True, "result.json"), (False, "result.json"), (True, "report.html")])
def test_a_session_that_ended_in_its_calibration_is_calibrated(rehearsed, collected, tmp_path, with_table, missing):
    plan = loaded(rehearsed / "plan.yaml")
    session = Path(shutil.copytree(collected(with_table), tmp_path / "session"))
    clouds, run = session / "clouds", session / "run"
    before = json.loads((run / "result.json").read_text(encoding="utf-8"))
    (run / missing).unlink()
    again = mbcacq.collect(plan, clouds, resume=run)
    assert (run / missing).exists()
    assert np.array_equal(hand_eye(again), np.array(before["T_flange_scanner"]))
    with pytest.raises(ConfigError, match="no cloud belongs to a pose that is still missing"):
        mbcacq.collect(plan, clouds, resume=run)


def test_the_command_checks_without_recording(rehearsed, tmp_path, monkeypatch):
    from click.testing import CliRunner

    from mbcacq.cli.app import app

    monkeypatch.chdir(tmp_path)
    found = CliRunner().invoke(
        app, ["collect", str(rehearsed / "plan.yaml"), "--clouds", str(rehearsed / "clouds"), "--check"], prog_name="mbcacq"
    )
    assert found.exit_code == 0, found.output
    assert "pose 3: cloud_0004.ply" in found.output
    assert "16 of 16 poses have clouds" in found.output
    assert list(tmp_path.iterdir()) == []


def test_resume_and_out_exclude_each_other(rehearsed):
    with pytest.raises(ConfigError, match="exclude each other"):
        mbcacq.collect(rehearsed / "plan.yaml", rehearsed / "clouds", out="a", resume="b")
