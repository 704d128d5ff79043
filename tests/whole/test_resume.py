"""kill -9 and --resume: the same observations as an undisturbed run, number by number; a changed plan is refused.

benchmarks/kill_and_resume.md has fifty random moments; here are a few.
"""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from dry_runs import plan_file
from typed_command import MBCACQ, ROOT, mbcacq, one_sentence, until

from mbcacq.recording import load_observations
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.progress import poses_done, repair_and_read_progress


def two_stations(plan):
    plan["stations"].append({"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [560, 160, 120], "abc_deg": [20, 0, 0]}})
    plan["steps"][0]["offsets_mm"] = [[10, 0, 0]]
    plan["steps"][1] |= {"stations": ["p1", "p2"], "views": plan["steps"][1]["views"][:3]}
    plan["exposures"] = 1
    still = {"encoder_noise_deg": 0.0, "encoder_step_deg": 0.0}  # a mean over another number of cycles is the same
    plan["fake"] = {"draws": "pose", "robot": still}
    plan["robot"]["model"] = "robot.yaml"


@pytest.fixture(scope="module")
def undisturbed(made_once):
    """(plan, folder of its whole run); to be looked at only: what locks it, even to refuse, is given a copy."""

    def make(folder):
        (folder / "robot.yaml").write_text((ROOT / "plans" / "robots" / "kr10_r1100_2.yaml").read_text())
        plan = plan_file(folder, two_stations)
        done = mbcacq("run", plan, "--dry-run", "--out", folder / "run", "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["gaps"] == []

    folder = made_once("resume-undisturbed", make)
    return folder / "plan.yaml", folder / "run"


def shared_memory_of(pid):
    """Names in /dev/shm that the process has mapped."""
    return {line.split("/dev/shm/")[1].split()[0] for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if "/dev/shm/" in line}


def killed_after(plan, run, poses, then_s=0.0):
    """Start a run, or go on with it, and kill it with all its children. Returns the names in shared memory that it used."""
    process = subprocess.Popen(
        [MBCACQ, "run", plan, "--dry-run", "--resume" if run.exists() else "--out", run],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    journal = run / "journal.jsonl"
    until(lambda: journal.exists() and journal.read_text().count("pose_done") >= poses)
    time.sleep(then_s)
    used = shared_memory_of(process.pid) if Path("/dev/shm").is_dir() else set()
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return used


def equal(run, whole):
    a, b = load_observations(whole), load_observations(run)
    assert sorted(b.pose_id.tolist()) == a.pose_id.tolist() == list(range(7))
    order = np.argsort(b.pose_id)
    rows = np.argsort(np.argsort(order)[b.pose], kind="stable")
    np.testing.assert_array_equal(b.ball[rows], a.ball)
    # A part's first scan is exposed twice, and the second exposure has noise of its own.
    anew = np.unique(a.pose[(b.xyz[rows] != a.xyz).any(axis=1)])
    assert len(anew) < len(layout.parts(run))
    np.testing.assert_allclose(b.xyz[rows], a.xyz, rtol=0, atol=0.1)
    np.testing.assert_array_equal(b.direction[order], a.direction)
    np.testing.assert_allclose(b.q[order], a.q, rtol=0, atol=1e-12)  # the mean over another number of equal cycles


def test_killed_and_resumed_is_the_same_as_undisturbed(undisturbed, tmp_path):
    """Killed before the first pose, resumed, killed after three."""
    plan, whole = undisturbed
    run, kills = tmp_path / "run", ((0, 0.0), (3, 0.1))
    for poses, then_s in kills:
        used = killed_after(plan, run, poses, then_s)
    if Path("/dev/shm").is_dir():  # shared memory as files: it does use some, and leaves nothing there
        assert used
        assert not used & set(os.listdir("/dev/shm"))
    assert mbcacq("recover", run).returncode == 0  # a recovery in between changes nothing
    assert load_observations(run).n_poses >= poses
    assert poses <= len(poses_done(run)) < 7
    assert any("of 7 planned poses were not measured" in gap for gap in find_gaps(run))
    resumed = mbcacq("run", plan, "--dry-run", "--resume", run, "--json")
    assert resumed.returncode == 0, resumed.stderr
    equal(run, whole)
    gaps = json.loads(resumed.stdout)["gaps"]
    assert 1 <= len(gaps) <= len(kills)  # the first kill may have come before there was anything to interrupt
    assert all("interrupted" in gap and "killed" in gap for gap in gaps)
    parts, merged = layout.parts(run), run / "whole.rrd"  # the parts are one recording, and one recording id
    assert len(parts) > 1
    assert sorted({int(row["pose"][0]) for row in Recording(merged).observed()}) == list(range(7))
    assert len({Recording(path).recording_id for path in (*parts, merged)}) == 1
    again = mbcacq("run", plan, "--dry-run", "--resume", run, "--json")
    assert again.returncode == 0
    assert "nothing moves" in again.stderr


def torn(whole, run, keep):
    """A run whose recording has the first bytes of another's, and whose journal is ahead of it, and torn itself."""
    run.mkdir()
    for name in ("plan.yaml", "plan.files.json"):
        (run / name).write_text((whole / name).read_text())
    (run / "run.rrd").write_bytes((whole / "run.rrd").read_bytes()[:keep])
    journal = (whole / "journal.jsonl").read_text().splitlines(keepends=True)
    (run / "journal.jsonl").write_text("".join(journal[:6]) + journal[6][:20])
    return run


def test_a_recording_torn_in_the_middle_is_no_obstacle(undisturbed, tmp_path):
    plan, whole = undisturbed
    data = (whole / "run.rrd").read_bytes()
    run = torn(whole, tmp_path / "run", len(data) // 2)
    resumed = mbcacq("run", plan, "--dry-run", "--resume", run)
    assert resumed.returncode == 0, resumed.stderr
    assert "was torn" in resumed.stderr
    equal(run, whole)
    assert [p for p in run.iterdir() if p.read_bytes()[: len(data) // 2] == data[: len(data) // 2]]  # the torn file is still there


def test_a_recording_torn_in_its_first_bytes_is_set_aside_and_its_poses_are_measured_again(undisturbed, tmp_path):
    _, whole = undisturbed
    run = torn(whole, tmp_path / "run", 7)
    progress = repair_and_read_progress(run)
    assert progress.done == frozenset()
    (said,) = progress.repairs
    assert "no pose can be read in run.rrd" in said
    assert [p for p in run.iterdir() if p.read_bytes() == (whole / "run.rrd").read_bytes()[:7]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p["robot"].update(speed=0.5), "the plan was changed: robot.speed was 0.25 and is 0.5"),
        (lambda p: p["steps"][1]["views"].pop(), "steps[1].views was a list of 3 and is one of 2"),
        (lambda p: p["scanner"].pop("exposure_us"), "scanner.exposure_us was 8000 and is not there"),
    ],
)
def test_a_changed_plan_is_refused_and_says_what_changed(undisturbed, tmp_path, change, words):
    _, whole = undisturbed
    plan = plan_file(tmp_path, lambda p: (two_stations(p), change(p)))
    (tmp_path / "robot.yaml").write_text((whole.parent / "robot.yaml").read_text())
    done = mbcacq("run", plan, "--dry-run", "--resume", shutil.copytree(whole, tmp_path / "run"))
    assert done.returncode == 2
    assert words in one_sentence(done)


def test_a_changed_robot_file_is_refused_a_comment_is_not(undisturbed, tmp_path):
    plan, whole = undisturbed
    model = (plan.parent / "robot.yaml").read_text()
    other = tmp_path / "plan.yaml"
    other.write_text("# a remark\n" + plan.read_text())
    (tmp_path / "robot.yaml").write_text("# a remark\n" + model)
    assert mbcacq("run", other, "--dry-run", "--resume", shutil.copytree(whole, tmp_path / "same")).returncode == 0
    (tmp_path / "robot.yaml").write_text(model.replace("d_mm: 515", "d_mm: 516"))
    done = mbcacq("run", other, "--dry-run", "--resume", shutil.copytree(whole, tmp_path / "changed"))
    assert done.returncode == 2
    assert "links[3].d_mm was 515 and is 516" in one_sentence(done)


def test_a_dry_run_is_not_resumed_with_the_real_cell_nor_another_seed(undisturbed, tmp_path):
    plan, whole = undisturbed
    run = shutil.copytree(whole, tmp_path / "run")
    for options in (["--yes"], ["--dry-run", "--seed", "1"]):
        done = mbcacq("run", plan, "--resume", run, *options)
        assert done.returncode == 2
        assert "was recorded with the fake cell of seed 0" in one_sentence(done)
