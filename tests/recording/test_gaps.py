"""What the journal says is missing; and a disk that takes the line but not its fsync."""

import errno
import os

import pytest
from run_events import pose_done

from mbcacq.acquisition import events
from mbcacq.errors import RecordingError
from mbcacq.recording.run_folder import journal as journal_module
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.journal import Journal


def started(n, at="2026-11-21T10:00:00+00:00"):
    return events.RunStarted(0.0, "x", at, "", "", n, {})


def gaps_of(folder, *stream):
    with Journal(folder) as journal:
        for event in stream:
            journal(event)
    return find_gaps(folder)


def test_an_undisturbed_run_has_no_gaps(tmp_path):
    assert gaps_of(tmp_path, started(2), pose_done(0), pose_done(1), events.RunStopped(2.0, "success", "all")) == []
    assert find_gaps(tmp_path / "nothing") == []


def test_poses_never_reached_and_interruptions_are_gaps(tmp_path):
    assert gaps_of(tmp_path, started(4), pose_done(0)) == ["3 of 4 planned poses were not measured: 1, 2, 3"]
    again = gaps_of(tmp_path, started(4, "2026-11-21T12:00:00+00:00"), pose_done(1), events.RunStopped(2.0, "fail", "the gate was opened"))
    assert again == [
        "2 of 4 planned poses were not measured: 2, 3",
        "the run was interrupted after 1 pose, the last of them pose 0 (it was killed) and went on at 2026-11-21T12:00:00+00:00",
    ]
    last = gaps_of(tmp_path, started(4, "2026-11-21T13:00:00+00:00"), pose_done(2), pose_done(3))
    assert last[1:] == [
        "the run was interrupted after 2 poses, the last of them pose 1 (the gate was opened) and went on at 2026-11-21T13:00:00+00:00"
    ]


def test_a_pose_left_out_is_a_gap_until_a_resumed_run_measured_it(tmp_path):
    left = events.Gap(1.0, "pose", "pose 1: 2 of 8 balls found, pose left out", 1)
    silent = events.Gap(1.0, "sensor", "the probe is silent; pose 0 has no air_C", 0)
    assert gaps_of(tmp_path, started(2), pose_done(0), silent, left) == [silent.text, left.text]
    resumed = gaps_of(tmp_path, started(2), pose_done(1))
    assert left.text not in resumed
    assert silent.text in resumed


@pytest.mark.parametrize(
    "call", ["fsync", pytest.param("write", marks=pytest.mark.skipif(not os.path.exists("/dev/full"), reason="/dev/full is of Linux"))]
)
def test_a_full_disk_is_one_sentence_and_closing_raises_nothing(tmp_path, monkeypatch, call):
    journal = Journal(tmp_path)
    journal(started(2))

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if call == "fsync":
        monkeypatch.setattr(journal_module.os, "fsync", full)
        with pytest.raises(RecordingError, match="No space left on device; free the disk and resume the run"):
            journal(pose_done(0))
        journal.close()
        return
    journal._journal.close()
    with open("/dev/full", "wb") as device:
        monkeypatch.setattr(journal, "_journal", device)
        with pytest.raises(RecordingError, match="No space left on device"):
            journal(pose_done(0))
        journal.close()


def test_poses_added_to_a_finished_run_are_no_interruption(tmp_path):
    ended = events.RunStopped(2.0, "success", "all poses measured")
    gaps_of(tmp_path, started(2), pose_done(0), pose_done(1), ended)
    gaps_of(tmp_path, started(4), pose_done(2), pose_done(3), ended)
    assert gaps_of(tmp_path, started(5), pose_done(4), ended) == ["poses were added to the run after pose 1, 3"]
