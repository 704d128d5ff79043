"""A file that leaves is the old one or the new one, whatever stops the writing."""

import errno
import os

import pytest

from mbcacq.errors import ExitCode, RecordingError
from mbcacq.files import atomic_write
from mbcacq.files.atomic_write import replacing, write_file, write_files


def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_file(tmp_path / "a.src", "good")
    write_files(tmp_path / "set", {"a": "1", "b": "2"})
    monkeypatch.setattr(atomic_write.os, "fsync", full)
    for write in (lambda: write_file(tmp_path / "a.src", "new"), lambda: write_files(tmp_path / "set", {"a": "3", "b": "4"})):
        with pytest.raises(RecordingError, match="No space left") as caught:
            write()
        assert caught.value.exit_code is ExitCode.RECORDING_FAILED
    assert (tmp_path / "a.src").read_text() == "good"
    assert {p.name: p.read_text() for p in (tmp_path / "set").iterdir()} == {"a": "1", "b": "2"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.src", "set"]


def test_a_set_that_was_half_renamed_says_so(tmp_path, monkeypatch):
    replace = os.replace
    write_files(tmp_path / "set", {"a": "1", "b": "2"})

    def second_fails(old, new):
        if str(new).endswith("b"):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        replace(old, new)

    monkeypatch.setattr(atomic_write.os, "replace", second_fails)
    with pytest.raises(RecordingError):
        write_files(tmp_path / "set", {"a": "3", "b": "4"})
    assert (tmp_path / "set" / "INCOMPLETE.txt").is_file()
    monkeypatch.undo()
    write_files(tmp_path / "set", {"a": "3", "b": "4"})
    assert {p.name: p.read_text() for p in (tmp_path / "set").iterdir()} == {"a": "3", "b": "4"}


def test_links_stay_links_and_devices_are_written_to(tmp_path):
    write_file(tmp_path / "real.txt", "old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_file(tmp_path / "link.txt", "new")
    write_file(os.devnull, "nothing")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"


def test_a_library_that_fails_while_writing_leaves_the_old_file(tmp_path):
    write_file(tmp_path / "x.rrd", b"old")

    def foreign_writer():
        with replacing(tmp_path / "x.rrd") as partial:
            partial.write_bytes(b"half")
            raise KeyError("of a library")

    with pytest.raises(KeyError):
        foreign_writer()
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"old"]
