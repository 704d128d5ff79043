"""Killed, torn and cut short: what was recorded is readable, or one sentence says that nothing is left."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import synthetic

from mbcacq.acquisition import events
from mbcacq.errors import RecordingError
from mbcacq.recording import load_observations
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd import sink as sink_module
from mbcacq.recording.rrd.reader import Recording, opened_once
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.progress import poses_done
from mbcacq.recording.run_folder.recovery import recover

WRITER = Path(__file__).with_name("writing_process.py")


def recovered_or_refused(path):
    try:
        return recover(path)[0], ""
    except RecordingError as error:
        return None, str(error)


def writing(folder, *arguments):
    return subprocess.Popen([sys.executable, str(WRITER), str(folder), *arguments], stdout=subprocess.PIPE, text=True)


on_posix = pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL and limits of file sizes are of POSIX")


@on_posix
@pytest.mark.parametrize("after_lines", [12, 41])
def test_kill_9_loses_a_tenth_of_a_second_at_most(tmp_path, after_lines):
    child = writing(tmp_path)
    lines = []
    for line in child.stdout:
        lines.append(line.split())
        if len(lines) >= after_lines:
            child.send_signal(signal.SIGKILL)
            break
    lines += [line.split() for line in child.stdout]  # what it still said before it died
    child.stdout.close()
    assert child.wait() == -signal.SIGKILL
    found = recover(tmp_path)[0]
    assert found.damaged
    assert not found.complete
    # Each line: what was handed to the recorder, and when that call returned.
    last = max(float(done) for _, _, done in lines)
    expected = {float(batch) for kind, batch, done in lines if kind == "cycles" and float(done) <= last - 0.1}
    assert expected <= set(Recording(found.output).cycles().columns["time_s"])
    finished = {int(number) for kind, number, _ in lines if kind == "pose"}
    assert finished <= set(load_observations(tmp_path).pose_id.tolist())
    assert finished <= poses_done(tmp_path)


def test_a_file_cut_at_any_byte_keeps_what_was_flushed(tmp_path):
    """Everything that was on the disk at a flush before the cut is recovered; a cut before the first pose is said to hold nothing."""
    folder = tmp_path / "run"
    sizes = []
    with Recorder(folder) as recorder:
        for event in synthetic.run(n_poses=5):
            recorder(event)
            if isinstance(event, events.PoseDone):
                sizes.append((folder / "run.rrd").stat().st_size)
    whole = (folder / "run.rrd").read_bytes()
    full = load_observations(folder)
    rng = random.Random(4)
    near = [size + d for size in (sizes[0], sizes[-1]) for d in (-1, 0)]
    cuts = [0, 12, len(whole) - 1, *near, *(rng.randrange(len(whole)) for _ in range(3))]
    torn = tmp_path / "torn.rrd"
    for cut in cuts:
        torn.write_bytes(whole[:cut])
        with opened_once():  # what is recovered is not opened a second time to be compared
            found, refusal = recovered_or_refused(torn)
            if found is None:
                assert "nothing could be recovered" in refusal
                assert cut < sizes[0]
                assert list(tmp_path.glob("*recovered*")) == []
                continue
            assert torn.read_bytes() == whole[:cut]
            assert found.damaged or found.complete  # a cut in the last bytes takes nothing away
            assert found.poses >= sum(size <= cut for size in sizes), cut
            if found.poses:
                obs = load_observations(found.output)
                np.testing.assert_array_equal(obs.q, full.q[: found.poses])
                np.testing.assert_array_equal(obs.xyz, full.xyz[: obs.n_centres])
                np.testing.assert_array_equal(obs.time_s, full.time_s[: found.poses])
        if found.damaged:
            found.output.unlink()


def test_an_empty_file_is_called_empty_and_nothing_is_promised_of_it(tmp_path):
    file = tmp_path / "empty.rrd"
    file.write_bytes(b"")
    with pytest.raises(RecordingError, match=r"empty\.rrd is empty: nothing was ever written into it") as error:
        load_observations(file)
    assert "mbcacq recover" not in str(error.value)
    with pytest.raises(RecordingError, match=r"nothing could be recovered from .*empty\.rrd: it is empty"):
        recover(file)


def test_a_torn_file_is_named_with_the_command_that_recovers_it(tmp_path):
    with Recorder(tmp_path) as recorder:
        for event in synthetic.run(n_poses=3):
            recorder(event)
    whole = (tmp_path / "run.rrd").read_bytes()
    (tmp_path / "run.rrd").write_bytes(whole[: len(whole) * 3 // 4])
    with pytest.raises(RecordingError, match=r"run\.rrd is torn .*mbcacq recover"):
        load_observations(tmp_path)
    found = recover(tmp_path)[0]
    assert found.output == tmp_path / "run.recovered.rrd"
    assert load_observations(tmp_path).n_poses == found.poses  # the folder now reads through the copy
    assert recover(tmp_path)[0].output == found.output  # and is not recovered again and again


def test_an_earlier_copy_is_not_overwritten(tmp_path):
    with Recorder(tmp_path / "run") as recorder:
        for event in synthetic.run(n_poses=3):
            recorder(event)
    whole = (tmp_path / "run" / "run.rrd").read_bytes()
    torn = tmp_path / "x.rrd"
    torn.write_bytes(whole[: len(whole) // 2])
    first = recover(torn)[0].output
    kept = first.read_bytes()
    time.sleep(0.01)
    torn.write_bytes(whole[: len(whole) * 3 // 4])
    second = recover(torn)[0].output
    assert (first.name, second.name) == ("x.recovered.rrd", "x.recovered-2.rrd")
    assert first.read_bytes() == kept
    assert layout.recovered_of(torn) == second


def test_parts_of_a_resumed_run_are_merged(tmp_path):
    with Recorder(tmp_path) as recorder:
        for event in synthetic.run(n_poses=2):
            recorder(event)
    rng = np.random.default_rng(5)
    with Recorder(tmp_path, part=1) as recorder:
        recorder(synthetic.start())
        for event in synthetic.pose(rng, 2, 1.0):
            recorder(event)
    whole = (tmp_path / "run.rrd").read_bytes()
    (tmp_path / "run.rrd").write_bytes(whole[:-200])
    expected = recover(tmp_path)
    assert [item.damaged for item in expected] == [True, False]
    parted, merged = load_observations(tmp_path), load_observations(tmp_path / "whole.rrd")
    assert merged.pose_id.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(merged.q, parted.q)
    np.testing.assert_array_equal(merged.xyz, parted.xyz)
    np.testing.assert_array_equal(merged.time_s, parted.time_s)


@on_posix
def test_a_full_disk_ends_the_run_by_name_and_keeps_what_was_written(tmp_path):
    """The size limit of files stands for a disk that takes no more."""
    child = writing(tmp_path, str(3 << 20))
    out, _ = child.communicate(timeout=900)
    assert child.returncode == 6
    lines = out.splitlines()
    assert lines[-1].startswith("error RecordingError:")
    finished = {int(line.split()[1]) for line in lines if line.startswith("pose")}
    assert finished
    recover(tmp_path)
    assert finished <= set(load_observations(tmp_path).pose_id.tolist())


@on_posix
def test_a_disk_that_takes_not_the_first_bytes_is_named_before_the_run(tmp_path):
    """The library's own writer ends there, and whoever hands it a stream waits for ever."""
    child = writing(tmp_path, "1000")
    try:
        out, _ = child.communicate(timeout=900)
    finally:
        child.kill()
    assert child.returncode == 6
    assert "run.rrd cannot be written" in out.splitlines()[-1]
    assert not (tmp_path / "run.rrd").exists()


def test_a_run_ends_before_the_disk_is_full(tmp_path, monkeypatch):
    stream = list(synthetic.run())
    cut = next(i for i, e in enumerate(stream) if isinstance(e, events.PoseReached) and e.pose == 2)
    recorder = Recorder(tmp_path)
    for event in stream[:cut]:
        recorder(event)
    monkeypatch.setattr(sink_module.shutil, "disk_usage", lambda path: type("Usage", (), {"free": 20 << 20})())
    scan = next(i for i, e in enumerate(stream) if i > cut and isinstance(e, events.ScanTaken))
    for event in stream[cut:scan]:
        recorder(event)
    with pytest.raises(RecordingError, match=r"almost full \(20 MiB free\)"):
        recorder(stream[scan])
    recorder.close()
    assert recover(tmp_path)[0].damaged is False  # the file was completed before the disk was full
    assert load_observations(tmp_path).pose_id.tolist() == [0, 1]


def test_a_run_that_will_not_fit_is_stopped_early(tmp_path, monkeypatch):
    stream = list(synthetic.run(n_poses=4))
    stream[0] = synthetic.start(n_poses=100_000)
    done = [i for i, e in enumerate(stream) if isinstance(e, events.PoseDone)]
    recorder = Recorder(tmp_path)
    monkeypatch.setattr(sink_module.shutil, "disk_usage", lambda path: type("Usage", (), {"free": 1 << 30})())
    for event in stream[: done[2]]:
        recorder(event)
    with pytest.raises(RecordingError, match=r"needs about \d+ MiB more, 1024 MiB are free"):
        recorder(stream[done[2]])
    recorder.close()
    assert load_observations(tmp_path).pose_id.tolist() == [0, 1, 2]


def test_too_little_space_is_refused_before_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 100 << 20})())
    with pytest.raises(RecordingError, match="only 100 MiB are free"):
        Recorder(tmp_path)
    assert not (tmp_path / "run.rrd").exists()


def test_a_run_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be made"):
        Recorder(tmp_path / "file" / "run")
