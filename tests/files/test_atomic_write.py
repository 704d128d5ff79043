"""A file that leaves is the old one or the new one, whatever stops the writing."""

import errno
import os

import pytest

from mbcacq.errors import ExitCode, RecordingError
from mbcacq.files import atomic_write
from mbcacq.files.atomic_write import finish_set, replacing, write_file, write_files


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


class Killed(BaseException):
    """The process ends here."""


@pytest.mark.parametrize("new_too", [False, True])
def test_a_set_that_is_stopped_anywhere_is_the_old_one_or_the_new_one(tmp_path, monkeypatch, new_too):
    """Stopped before each rename, synchronisation and removal; whoever reads next completes it, or finds the old set."""
    old = {"a": "1", "b": "2", "c": "3"}
    new = {name: text * 2 for name, text in old.items()} | ({"d": "44"} if new_too else {})
    ends = []
    for stop in range(100):
        folder = tmp_path / str(stop)
        write_files(folder, old)
        left = stop

        def counted(call):
            def wrapper(*arguments, **options):
                nonlocal left
                left -= 1
                if left < 0:
                    raise Killed
                return call(*arguments, **options)

            return wrapper

        with monkeypatch.context() as patched:
            for name in ("replace", "fsync", "unlink"):
                patched.setattr(atomic_write.os, name, counted(getattr(os, name)))
            try:
                write_files(folder, new)
            except Killed:
                pass
            else:
                break
        finish_set(folder)
        found = {p.name: p.read_text() for p in folder.iterdir() if not p.name.endswith(".part")}
        assert found in (old, new)
        ends.append(found == new)
    assert ends == sorted(ends)  # from one moment on
    assert {True, False} == set(ends)


def test_a_rename_that_fails_is_an_error_and_the_next_writer_completes_the_set(tmp_path, monkeypatch):
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
    write_files(tmp_path / "set", {"c": "5"})
    assert {p.name: p.read_text() for p in (tmp_path / "set").iterdir()} == {"a": "3", "b": "4", "c": "5"}


@pytest.mark.parametrize("line", ['{"name": "../a", "from": "a.1-2.part"}', '{"name": "a", "from": "b"}', "a", "[]"])
def test_a_list_that_is_not_ours_moves_nothing(tmp_path, line):
    (tmp_path / "set").mkdir()
    for name in ("a.1-2.part", "set/b", "set/a.1-2.part"):
        (tmp_path / name).write_text("x")
    (tmp_path / "set" / "INCOMPLETE.txt").write_text(f"of somebody\n{line}\n")
    finish_set(tmp_path / "set")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["INCOMPLETE.txt", "a.1-2.part", "a.1-2.part", "b", "set"]


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


def test_temporary_names_are_on_the_disk_before_a_set_is_listed(tmp_path, monkeypatch):
    """Else a power cut may keep the list and take the files that it lists."""
    write_files(tmp_path / "set", {"a": "1", "b": "2"})
    done = []
    monkeypatch.setattr(atomic_write, "sync_folder", lambda folder: done.append("folder"))
    replace = os.replace
    monkeypatch.setattr(atomic_write.os, "replace", lambda old, new: (done.append(os.path.basename(new)), replace(old, new)))
    write_files(tmp_path / "set", {"a": "3", "b": "4"})
    assert done[:2] == ["folder", "INCOMPLETE.txt"]


def test_a_function_writes_its_file_of_a_set_and_a_failure_leaves_the_old_set(tmp_path):
    def fails(partial):
        partial.write_bytes(b"half")
        raise RecordingError("the disk is full")

    seen = []
    write_files(tmp_path / "set", {"a": "1", "b": lambda partial: partial.write_bytes(b"2")})
    with pytest.raises(RecordingError, match="the disk is full"):
        write_files(tmp_path / "set", {"a": "3", "b": fails})
    assert {p.name: p.read_text() for p in (tmp_path / "set").iterdir()} == {"a": "1", "b": "2"}

    def note(name, partial):
        seen.append((name, partial.read_text(), (tmp_path / "set" / name).read_text()))

    write_files(tmp_path / "set", {"a": "3", "b": lambda partial: partial.write_bytes(b"4")}, on_disk=note)
    assert seen == [("a", "3", "1"), ("b", "4", "2")]
