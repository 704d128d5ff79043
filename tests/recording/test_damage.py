"""Bits that change on the disk: found and named, left out, restored from another copy. Never a wrong centre without a word."""

import itertools
import json
import os
import random
import re
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest
import synthetic
from click.testing import CliRunner

from mbcacq.cli.recover import command as recover_command
from mbcacq.errors import ConfigError, MbcacqError, RecordingError
from mbcacq.estimation.forward_model import CellState
from mbcacq.files import atomic_write
from mbcacq.model.json_text import sealed_text
from mbcacq.recording import load_observations
from mbcacq.recording.rrd.checked_lines import checked_line, read_lines
from mbcacq.recording.rrd.checksums import Stretch, digest_of_file, digest_of_values, is_as_written, note_made, note_stretch, read_stretches
from mbcacq.recording.rrd.reader import Recording, opened_once
from mbcacq.recording.rrd.result_recording import log_result
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.check import check
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.journal import Journal, read_journal
from mbcacq.recording.run_folder.progress import poses_done, repair_and_read_progress
from mbcacq.recording.run_folder.run_plan import keep_plan, plan_files_text, read_kept_plan, refuse_change
from mbcacq.workflow import diagnosis_files
from mbcacq.workflow.diagnosis_files import keep_in_run

FILES = {"robots/made.yaml": "name: six axes\n", "balls.yaml": "id: mbc\n"}
CELL = "the fake cell of seed 0"
COPIES = ("plan.yaml", "plan.files.json")
NO_CENTRES = {"pose": [], "ball": [], "point_mm": [], "before_mm": [], "after_mm": [], "of": 0}
PICTURES = {"centres": NO_CENTRES, "causes": []}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run folder with its plan, written from synthetic events."""
    from dataclasses import replace

    folder = tmp_path_factory.mktemp("recorded") / "run"
    files = plan_files_text(FILES, CELL)
    keep_plan(folder, synthetic.PLAN, files)
    with Recorder(folder) as recorder, Journal(folder) as journal:
        for event in synthetic.run(n_poses=4):
            event = replace(event, plan_files=files) if event.__class__.__name__ == "RunStarted" else event
            recorder(event)
            journal(event)
    return folder


@pytest.fixture
def folder(recorded, tmp_path) -> Path:
    return shutil.copytree(recorded, tmp_path / "run")


def flip(path: Path, at: int, bit: int = 0) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(data)


def faults(folder: Path) -> list[str]:
    return [f"{file.path.name}: {fault}" for file in check(folder) for fault in file.faults]


def test_an_undamaged_run_has_no_faults_and_every_byte_has_a_checksum(folder):
    assert faults(folder) == []
    assert {file.path.name: file.unverified for file in check(folder)} == dict.fromkeys(
        ("run.rrd", "journal.jsonl", "log.jsonl", "checksums.jsonl", "plan.yaml", "plan.files.json", "recording.json"), 0
    )


def test_one_flipped_bit_in_a_stored_centre_is_found_named_and_left_out(folder):
    true = load_observations(folder)
    row = next(row for row in Recording(folder / "run.rrd").observed() if row["pose"][0] == 2)
    at = (folder / "run.rrd").read_bytes().rindex(row["xyz"][:3].tobytes())
    flip(folder / "run.rrd", at + 5, 3)
    assert any("the observation of pose 2" in fault for fault in faults(folder))
    assert any(
        re.search(r"\(with pose [^)]*\b2\b[^)]*\) are not as they were written", fault) for fault in faults(folder)
    )  # several at once on a slow disk
    left = load_observations(folder)
    assert left.pose_id.tolist() == [0, 1, 3]
    assert set(map(tuple, left.xyz.tolist())) < set(map(tuple, true.xyz.tolist()))
    assert any("pose 2 was measured, but the recording holds no intact values" in gap for gap in find_gaps(folder))
    assert poses_done(folder) == {0, 1, 3}  # a resumed run measures it again
    done = CliRunner().invoke(recover_command, ["--check", str(folder)])
    assert isinstance(done.exception, RecordingError)
    assert "pose 2" in done.output


def test_a_cell_with_a_flipped_bit_is_read_from_its_copy_and_refused_without(folder):
    data = (folder / "run.rrd").read_bytes()
    true = load_observations(folder).cell_yaml
    places = [k for k in range(len(data)) if data.startswith(b"a comment that must survive", k)]
    assert len(places) == 3  # the cell, its copy, and what the viewer shows of it
    refused = []
    for pair in itertools.combinations(places, 2):
        (folder / "run.rrd").write_bytes(data)
        flip(folder / "run.rrd", pair[0])
        assert load_observations(folder).cell_yaml == true
        flip(folder / "run.rrd", pair[1])
        try:
            assert load_observations(folder).cell_yaml == true
        except RecordingError as error:
            refused.append(str(error))
    (said,) = refused  # of the three pairs that of the cell and its copy
    assert "its cell is damaged" in said


def test_no_flipped_bit_anywhere_is_missed_or_becomes_a_wrong_value(folder, recorded):
    """Few places; benchmarks/faults.py flipped-bits has more of them."""
    true = load_observations(recorded)
    centres = {(pose, ball): xyz for pose, ball, xyz in zip(true.pose_id[true.pose], true.ball, true.xyz.tolist(), strict=True)}
    rng = random.Random(7)
    for name in ("run.rrd",) * 4 + ("journal.jsonl", "log.jsonl", "checksums.jsonl", *COPIES, "recording.json"):
        at = rng.randrange((recorded / name).stat().st_size)
        flip(folder / name, at, rng.randrange(8))
        with opened_once():
            assert any(fault.startswith(name) for fault in faults(folder)), (name, at)
            try:
                found = load_observations(folder)
            except MbcacqError:
                found = None
        if found is not None:
            assert found.cell_yaml == true.cell_yaml
            np.testing.assert_array_equal(found.q, true.q[np.searchsorted(true.pose_id, found.pose_id)])
            for pose, ball, xyz in zip(found.pose_id[found.pose], found.ball, found.xyz.tolist(), strict=True):
                assert centres[pose, ball] == xyz, (name, at)
        shutil.copy(recorded / name, folder / name)


DAMAGE = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "emptied": lambda path: path.write_bytes(b""),
    "zeroed": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "one bit": lambda path: flip(path, path.stat().st_size // 2),
    "first bit": lambda path: flip(path, 0, 7),
    "missing": lambda path: path.unlink(),
}


@pytest.mark.parametrize("name", COPIES)
@pytest.mark.parametrize("how", DAMAGE)
def test_a_damaged_copy_of_the_plan_is_restored_from_the_recording(folder, recorded, name, how):
    DAMAGE[how](folder / name)
    assert any(fault.startswith(name) for fault in faults(folder))
    kept = read_kept_plan(folder)
    assert (kept.plan, dict(kept.files), kept.cell) == (synthetic.PLAN, FILES, CELL)
    assert [repair for repair in kept.repairs if name in repair and "restored from run.rrd" in repair] == list(kept.repairs)
    assert (folder / name).read_bytes() == (recorded / name).read_bytes()
    assert faults(folder) == []
    refuse_change(folder, kept, synthetic.PLAN, FILES, CELL)
    with pytest.raises(ConfigError, match="balls.yaml was changed: id was"):
        refuse_change(folder, kept, synthetic.PLAN, FILES | {"balls.yaml": "id: other\n"}, CELL)


def place_of_some(digest: bytes, data: bytes) -> int:
    """Where a part of a digest stands: compression leaves text out that came before, and of a digest, at random, four characters here or there.
    What a chunk holds, and so what came before, depends on how fast it was written."""
    pieces = (digest[k : k + 12] for k in range(len(digest) - 11))
    return next(data.index(piece) for piece in pieces if piece in data)


def test_a_run_without_any_copy_of_its_plan_can_still_be_resumed(folder):
    for name in COPIES:
        (folder / name).write_bytes(b"\0" * 40)
    for text in (synthetic.PLAN, plan_files_text(FILES, CELL)):
        flip(folder / "run.rrd", place_of_some(digest_of_values({"text": text}).encode(), (folder / "run.rrd").read_bytes()))
    kept = read_kept_plan(folder)
    assert kept.plan is None
    assert kept.files is None
    assert len(kept.repairs) == 2
    refuse_change(folder, kept, "name: other\n", {}, "real")
    assert repair_and_read_progress(folder).done == {0, 1, 2, 3}


def test_what_was_computed_from_a_run_is_checked_and_read_without_a_second_process(folder):
    obs = load_observations(folder)
    place = np.eye(4)
    place[:3, 3] = [300.0, 0.0, 100.0]
    state = CellState(obs.cell.robot.chain, obs.cell.T_flange_scanner, np.stack([place, place]), obs.cell.ball_centres)
    path = log_result(folder, obs, state)
    (folder / "result.json").write_text(sealed_text({"format": "mbcacq-result/1", "value": 0.25}))
    keep_in_run({"effects": []}, "nothing", PICTURES, obs, folder)
    computed = ["result.rrd", "diagnosis.rrd", "diagnosis.json", "diagnosis-pictures.json", "result.json"]
    assert [file.path.name for file in check(folder)][-5:] == computed
    assert faults(folder) == []
    assert is_as_written(path)  # else the viewer's reader needs a process of its own
    assert is_as_written(folder / "diagnosis.rrd")
    for name in computed:
        flip(folder / name, (folder / name).read_bytes().rindex(b"2") if name == "result.json" else (folder / name).stat().st_size // 2)
    assert faults(folder) == [f"{name}: it is not as it was written" for name in computed]
    for name in computed:
        (folder / name).unlink()
    assert faults(folder) == []  # they may be deleted: they can be computed again


def test_a_diagnosis_is_the_old_one_or_the_new_one_with_its_recording(folder, monkeypatch):
    obs = load_observations(folder)
    keep_in_run({"effects": []}, "nothing", PICTURES, obs, folder)
    before = {name: (folder / name).read_bytes() for name in ("diagnosis.json", "diagnosis-pictures.json", "diagnosis.rrd")}

    def full(*_):
        raise RecordingError("the disk is full")

    monkeypatch.setattr(diagnosis_files, "stream_diagnosis", full)
    with pytest.raises(RecordingError, match="the disk is full"):
        keep_in_run({"effects": [1]}, "something", PICTURES, obs, folder)
    assert {name: (folder / name).read_bytes() for name in before} == before
    assert faults(folder) == []


def test_a_checksum_that_was_noted_for_a_file_that_never_came_accuses_nobody(folder):
    """It is on the disk before the file takes its name: a power cut between leaves the old file, which was noted, too."""
    keep_in_run({"effects": []}, "nothing", PICTURES, load_observations(folder), folder)
    (folder / "new").write_text("another diagnosis")
    note_made(folder / "new", folder / "diagnosis.json")
    assert faults(folder) == []
    assert is_as_written(folder / "diagnosis.json")
    (folder / "diagnosis.json").write_text("a third one")
    assert faults(folder) == ["diagnosis.json: it is not as it was written"]


def test_a_damaged_line_of_the_journal_is_not_believed(folder):
    journal = folder / "journal.jsonl"
    at = journal.read_bytes().index(b'"pose": 1') + len(b'"pose": ')
    flip(journal, at, 1)  # pose 1 becomes pose 3
    assert [entry["pose"] for entry in read_journal(folder) if entry["event"] == "pose_done"] == [0, 2, 3]
    assert poses_done(folder) == {0, 2, 3}


def test_lines_of_an_earlier_version_are_believed_where_they_stand_first(folder):
    journal = folder / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    old = json.dumps({"event": "pose_done", "pose": 77}) + "\n"
    journal.write_text(old + "".join(lines) + old)
    assert [entry.get("pose") for entry in read_journal(folder)].count(77) == 1


def test_every_bit_of_the_first_line_is_checked_also_those_that_name_its_checksum(tmp_path):
    path = tmp_path / "journal.jsonl"
    first = checked_line({"event": "pose_done", "pose": 0, "time_s": 0.25})
    for at, bit in itertools.product(range(len(first) - 1), range(8)):
        path.write_bytes(first + checked_line({"event": "pose_done", "pose": 1}))
        flip(path, at, bit)
        found = read_lines(path)
        assert found.damaged, (at, bit)
        assert [entry["pose"] for entry in found.entries] == [1]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no handle of a folder")
def test_a_file_is_on_the_disk_before_the_folder_names_it(tmp_path, monkeypatch):
    calls = []
    sync, replace = os.fsync, os.replace
    monkeypatch.setattr(
        atomic_write.os,
        "fsync",
        lambda handle: (calls.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file"), sync(handle)),
    )
    monkeypatch.setattr(atomic_write.os, "replace", lambda old, new: (calls.append("rename"), replace(old, new)))
    keep_plan(tmp_path, "a: 1\n", "{}")
    assert calls == ["file", "rename", "folder"] * 2


def test_a_recording_that_ends_before_its_cell_is_no_obstacle_to_resuming(folder):
    """Readable as a file, and of no use: what a write error in the first second of a run leaves."""
    import rerun as rr

    from mbcacq.recording.rrd import layout

    stream = rr.RecordingStream(layout.APPLICATION, send_properties=False)
    (folder / "run.rrd").unlink()
    stream.save(str(folder / "run.rrd"))
    stream.log(layout.LOG, rr.TextLog("made"))
    stream.disconnect()
    progress = repair_and_read_progress(folder)
    assert progress.done == frozenset()
    assert "run.rrd.empty" in progress.repairs[0]


def test_a_full_disk_while_resuming_sets_no_recording_aside(folder, monkeypatch):
    data = (folder / "run.rrd").read_bytes()
    (folder / "run.rrd").write_bytes(data[: len(data) * 3 // 4])
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 0})())
    with pytest.raises(RecordingError, match="free some space"):
        repair_and_read_progress(folder)
    assert (folder / "run.rrd").exists()


ENDS = {None: 8397, 0: 12518, 2: 16710, 3: 20848}  # of the bytes of three_poses.rrd in which a pose was finished
ABORTS = {"a length in a buffer": (15279, 2), "the name of a column": (13865, 4)}  # byte, bit: here rerun 0.41 ends its process


@pytest.fixture
def three_poses(tmp_path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(Path(__file__).with_name("three_poses.rrd"), folder / "run.rrd")
    start = 0
    for pose, end in ENDS.items():
        digest = digest_of_file(folder / "run.rrd", start, end)[0]
        note_stretch(folder, Stretch("run.rrd", start, end, digest, () if pose is None else (pose,)))
        start = end
    lines = [checked_line({"event": "pose_done", "pose": pose, "station": "1"}) for pose in ENDS if pose is not None]
    (folder / "journal.jsonl").write_bytes(b"".join(lines))
    return folder


@pytest.mark.parametrize("where", ABORTS)
def test_a_bit_at_which_the_rerun_library_aborts_ends_in_a_sentence(three_poses, where):
    true = load_observations(three_poses)
    assert true.pose_id.tolist() == [0, 2, 3]
    flip(three_poses / "run.rrd", *ABORTS[where])
    with pytest.raises(RecordingError, match="is damaged: the library that reads recordings gave up at it"):
        load_observations(three_poses)
    found = faults(three_poses)
    assert any("bytes 12518 to 16710 (with pose 2) are not as they were written" in fault for fault in found)
    assert any("it cannot be read as a recording" in fault for fault in found)


def test_a_run_goes_on_without_the_damaged_stretch_that_rerun_cannot_read(three_poses):
    true = load_observations(three_poses)
    data = bytearray((three_poses / "run.rrd").read_bytes())
    at, bit = ABORTS["a length in a buffer"]
    flip(three_poses / "run.rrd", at, bit)
    progress = repair_and_read_progress(three_poses)
    assert progress.done == {0, 3}  # pose 2 is measured again
    assert "its 2 finished poses are in run.recovered.rrd" in progress.repairs[0]
    left = load_observations(three_poses)
    assert left.pose_id.tolist() == [0, 3]
    assert set(map(tuple, left.xyz.tolist())) < set(map(tuple, true.xyz.tolist()))
    data[at] ^= 1 << bit
    assert (three_poses / "run.rrd").read_bytes() == data  # the original stays as it is
    assert sorted(path.name for path in three_poses.iterdir() if ".rrd" in path.name) == ["run.recovered.rrd", "run.rrd"]


def test_a_recording_without_checksums_is_read_with_the_same_values(three_poses):
    true = load_observations(three_poses)
    (three_poses / "checksums.jsonl").unlink()
    found = load_observations(three_poses / "run.rrd")
    assert found.cell_yaml == true.cell_yaml
    np.testing.assert_array_equal(found.q, true.q)
    np.testing.assert_array_equal(found.xyz, true.xyz)


@pytest.mark.parametrize("value", ["1e999", "-1", "nan", "[]", '"x"', "null"])
def test_a_line_of_checksums_without_sensible_numbers_does_not_count(folder, value):
    line = f'{{"file": "plan.yaml", "start": {value}, "end": {value}, "poses": [{value}], "sha256": "00"}}'
    (folder / "checksums.jsonl").write_text(line + "\n")
    assert read_stretches(folder)[0] == {}
