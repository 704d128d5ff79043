"""The newest run by the name ``latest``."""

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.recording.run_folder.latest import mark_latest, named_run
from mbcacq.recording.viewer import open_viewer

PLANS = Path(__file__).parents[2] / "plans"


@pytest.fixture
def desk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def new_run(folder):
    folder = Path(folder)
    folder.mkdir(parents=True)
    (folder / "run.rrd").touch()
    mark_latest(folder)
    return folder


def no_links(*_, **__):
    raise OSError("a required privilege is not held by the client")


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("name", ["latest", "runs/latest"])
def test_latest_names_the_newest_of_several_runs(desk, monkeypatch, links, name):
    if not links:
        monkeypatch.setattr(Path, "symlink_to", no_links)
    for folder in ("runs/1_kuka", "runs/today", "elsewhere"):
        new_run(folder)
    assert named_run(Path(name)) == Path("runs/today")
    assert (desk / "runs" / "latest").is_symlink() is links
    assert sorted(p.name for p in (desk / "runs").iterdir() if p.name.startswith(".")) == []
    assert not (desk / "latest").exists()


def test_view_of_latest_opens_the_newest_run(desk, monkeypatch):
    opened = []
    monkeypatch.setattr(open_viewer, "view", lambda sources, opening: opened.extend(sources))
    for folder in ("runs/1_kuka", "runs/2_kuka"):
        new_run(folder)
    assert CliRunner().invoke(app, ["view", "latest"], standalone_mode=False).exception is None
    assert opened == [Path("runs/2_kuka/run.rrd")]


def test_without_a_run_latest_says_how_to_start_one(desk):
    for command in ("view", "report", "calibrate", "diagnose"):
        done = CliRunner().invoke(app, [command, "latest"])
        assert done.exit_code == 2
        assert "runs/latest does not exist, runs holds no run yet; give the folder of one, or start one" in done.stderr
    shutil.rmtree(new_run("runs/gone"))
    with pytest.raises(ConfigError, match="which is gone"):
        named_run(Path("latest"))


@pytest.mark.parametrize("leads_to", ["../elsewhere", "ABSOLUTE", ".."])
@pytest.mark.parametrize("link", [True, False])
def test_a_mark_that_leads_out_of_the_runs_is_not_followed(desk, leads_to, link):
    for folder in ("runs/1_kuka", "elsewhere"):
        new_run(folder)
    mark, target = desk / "runs" / "latest", leads_to.replace("ABSOLUTE", str(desk / "elsewhere"))
    mark.unlink()
    if link:
        mark.symlink_to(target)
    else:
        mark.write_text(f"{target}\n")
    assert named_run(Path("latest")) == Path("runs/1_kuka")


def test_a_run_that_is_itself_called_latest_is_left_alone(desk):
    new_run("runs/latest")
    new_run("runs/other")
    assert not (desk / "runs" / "latest").is_symlink()
    assert named_run(Path("latest")) == Path("runs/latest")


@pytest.mark.parametrize("command", ["report", "view", "calibrate", "diagnose", "compare"])
def test_a_plan_in_place_of_a_run_says_to_execute_it_first(command):
    done = CliRunner().invoke(app, [command, str(PLANS / "quick.yaml")])
    assert done.exit_code == 2, done.exception
    assert f"quick.yaml is a plan, nothing was measured yet; execute it (without hardware: mbcacq run {PLANS}" in done.stderr
