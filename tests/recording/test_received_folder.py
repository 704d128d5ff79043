"""A run folder from somebody else may hold links: nothing is written through one that leads out of it."""

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import MbcacqError, RecordingError
from mbcacq.files.atomic_write import write_file, write_files
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.journal import Journal
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.recovery import recover
from mbcacq.recording.run_folder.run_plan import keep_plan

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows makes links for administrators only")
LINKS = ("report.html", "result.json", "plan.yaml", "run.part2.rrd", "journal.jsonl", "log.jsonl", "checksums.jsonl", ".run.lock")
LINKS += (".run.lock.json", ".run.recovered.part.rrd", "INCOMPLETE.txt", "scans")


def locked(folder: Path) -> None:
    with write_lock(folder, "run"):
        pass


WRITERS = {
    "recover": recover,
    "lock": locked,
    "resume": lambda folder: Recorder(folder, part=1).close(),
    "journal": lambda folder: Journal(folder).close(),
    "plan": lambda folder: keep_plan(folder, "name: a\n", "{}\n"),
    "result": lambda folder: write_file(folder / "result.json", "{}"),
    "set": lambda folder: write_files(folder, {"scans/1.ply": "1", "scans/2.ply": "2", "INCOMPLETE.txt": "3"}),
    "report": lambda folder: CliRunner().invoke(app, ["report", str(folder)]),
}


@pytest.mark.parametrize("link", ["to a file", "to nothing", "hard"])
def test_nothing_is_written_through_twelve_links(a_run, tmp_path, link):
    with (a_run / "run.rrd").open("r+b") as torn:
        torn.truncate(a_run.joinpath("run.rrd").stat().st_size - 100)
    home = tmp_path / "home"
    home.mkdir()
    for name in LINKS:
        path, target = a_run / name, home / name.lstrip(".")
        if link != "to nothing" and name == "scans":
            target.mkdir()
        elif link != "to nothing":
            target.write_bytes(path.read_bytes() if path.is_file() else b"mine\n")
        path.unlink(missing_ok=True)
        (path.hardlink_to if link == "hard" and name != "scans" else path.symlink_to)(target)
    before = {path.name: path.is_dir() or path.read_bytes() for path in home.rglob("*")}
    for name, write in WRITERS.items():
        try:
            write(a_run)
        except MbcacqError:
            pass
        assert {path.name: path.is_dir() or path.read_bytes() for path in home.rglob("*")} == before, name


@pytest.mark.parametrize("name", ["report.html", "deep/report.html"])
def test_a_link_out_of_the_folder_is_named_with_where_it_leads(tmp_path, name):
    folder, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    (folder / "deep").symlink_to(elsewhere)
    (folder / "report.html").symlink_to(elsewhere / "report.html")
    with pytest.raises(RecordingError, match=r"report\.html is a link to .*elsewhere.report\.html, outside its folder.*remove the link"):
        write_file(folder / name, "new", folder=folder)
    assert not list(elsewhere.iterdir())


def test_a_recording_that_is_a_folder_is_none(tmp_path):
    (tmp_path / "run.rrd").mkdir()
    with pytest.raises(RecordingError, match="it is no file, or a link that leads to none"):
        recover(tmp_path)


def test_a_list_of_a_stopped_set_renames_nothing_outside(tmp_path):
    folder, home = tmp_path / "run", tmp_path / "home"
    folder.mkdir()
    home.mkdir()
    (home / "notes").write_text("mine")
    (home / "notes.1-2.part").write_text("theirs")
    (folder / "notes").symlink_to(home / "notes")
    (folder / "INCOMPLETE.txt").write_text('of a set\n{"name": "notes", "from": "notes.1-2.part"}\n')
    locked(folder)
    write_file(folder / "result.json", "{}")
    assert (home / "notes").read_text() == "mine"
