"""Kinds of recordings in a folder of runs: 'latest' is the newest that a command can use, and a check is no run."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.fleet.recordings import find_recordings
from mbcacq.recording.run_folder.latest import mark_latest, named_run
from mbcacq.recording.run_folder.register import ANY_KIND, RunKind, kind_of, newest
from mbcacq.recording.run_folder.run_plan import FILES, plan_files_text


@pytest.fixture
def desk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def recorded(name, started, kind=None):
    folder = Path("runs") / name
    folder.mkdir(parents=True)
    (folder / "run.rrd").touch()
    (folder / "recording.json").write_text(json.dumps({"recording_id": name, "started": started, "name": name}))
    if kind is not None:
        (folder / FILES).write_text(plan_files_text({}, "real", kind))
    mark_latest(folder, kind_of(folder))
    return folder


def test_a_check_does_not_become_the_latest_run(desk):
    run, check = recorded("cell", "2026-03-01T08:00:00", "run"), recorded("morning", "2026-03-02T08:00:00", "check")
    assert named_run(Path("latest")) == named_run(Path("runs/latest")) == run
    assert named_run(Path("latest"), frozenset({RunKind.CHECK})) == named_run(Path("latest"), ANY_KIND) == check


def test_the_run_that_was_started_last_is_the_latest_though_the_clock_was_set_back(desk):
    recorded("2026-03-09T08-00-00_cell", "2026-03-09T08:00:00+00:00", "run")
    after = recorded("2026-03-02T08-00-00_cell", "2026-03-02T08:00:00+00:00", "run")
    recorded("2026-03-02T09-00-00_check-cell", "2026-03-02T09:00:00+00:00", "check")
    assert named_run(Path("latest")) == after


def test_where_a_copy_of_the_runs_has_the_newest_run_instead_of_its_mark_a_later_run_is_the_latest(desk):
    recorded("monday", "2026-03-02T08:00:00+00:00", "run")
    shutil.copytree("runs", "stick")  # as FAT has no links: 'latest' is a folder with Monday's run
    shutil.rmtree("runs")
    shutil.copytree("stick", "runs")
    assert named_run(Path("latest")) == Path("runs/monday")
    tuesday = recorded("tuesday", "2026-03-03T08:00:00+00:00", "run")
    assert named_run(Path("latest")) == tuesday


def test_a_mark_that_an_older_version_set_on_a_check_or_that_names_a_lost_folder_is_read_past(desk):
    run = recorded("cell", "2026-03-01T08:00:00")
    check = recorded("2026-03-02T08-00-00_check-kuka", "2026-03-02T08:00:00")
    assert kind_of(check) is RunKind.CHECK
    for lost in (check.name, "gone"):
        Path("runs/latest").unlink()
        Path("runs/latest").symlink_to(lost)
        assert named_run(Path("latest")) == run


def test_a_folder_with_checks_alone_has_no_latest_run(desk):
    recorded("2026-03-02T08-00-00_check-kuka", "2026-03-02T08:00:00")
    with pytest.raises(ConfigError, match="runs holds no run yet"):
        named_run(Path("latest"))


def test_the_newest_of_a_kind_goes_by_its_start_and_not_by_its_name(desk):
    late = recorded("a", "2026-03-05T08:00:00", "collected")
    recorded("z", "2026-03-01T08:00:00", "investigation")
    assert newest(Path("runs"), ANY_KIND) == late
    assert newest(Path("runs"), frozenset({RunKind.INVESTIGATION})) == Path("runs/z")
    assert newest(Path("runs"), frozenset({RunKind.EXTENSION})) is None


def test_a_check_in_place_of_a_run_is_refused_with_what_reads_it(desk):
    check = recorded("morning", "2026-03-02T08:00:00", "check")
    done = CliRunner().invoke(app, ["calibrate", str(check)])
    assert done.exit_code == 2
    assert "is a check" in done.stderr
    assert f"mbcacq report {check}" in done.stderr
    done = CliRunner().invoke(app, ["report", str(check)])
    assert f"mbcacq check RESULT PLAN --from {check}" in done.stderr


def test_a_fleet_leaves_checks_out(desk):
    run = recorded("cell", "2026-03-01T08:00:00", "run")
    recorded("morning", "2026-03-02T08:00:00", "check")
    assert [Path(one.path).name for one in find_recordings([Path("runs")])] == [run.name]
