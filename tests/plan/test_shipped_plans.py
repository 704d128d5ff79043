"""The tool's own plans are found by their names in an empty folder, and copied with all that they name."""

import os

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.files import atomic_write
from mbcacq.model import shipped
from mbcacq.plan import load
from mbcacq.workflow.copy_plan import copy_plan


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["kuka", "kuka.yaml", "plans/kuka.yaml", "plans/kuka"])
def test_a_shipped_plan_is_found_where_no_file_is(name):
    assert load(name).path == shipped.folder() / "kuka.yaml"


def test_a_file_of_that_name_comes_first_and_other_folders_stay_what_they_are(tmp_path):
    (tmp_path / "kuka.yaml").write_text("format: mine\n")
    with pytest.raises(ConfigError, match="kuka.yaml:1"):
        load("kuka.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load("my/plans/kuka.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load("kuka.json")


@pytest.mark.parametrize("name", shipped.plans())
def test_a_copy_loads_as_the_shipped_plan_does(name, tmp_path):
    first, *others = copy_plan(name, tmp_path / "mine")
    assert load(first).files == load(name).files
    assert all(path.is_relative_to(tmp_path / "mine") for path in others)
    assert copy_plan(name, tmp_path / "mine")[0] == first  # the same again changes nothing
    first.write_text("changed")
    with pytest.raises(ConfigError, match="exists and differs"):
        copy_plan(name, tmp_path / "mine")
    assert first.read_text() == "changed"
    copy_plan(name, tmp_path / "mine", force=True)
    assert load(first).text == load(name).text


@pytest.mark.parametrize("stop", range(4))
def test_a_copy_that_is_stopped_anywhere_has_plan_and_robot_of_one_version(tmp_path, monkeypatch, stop):
    """Killed before one of its renamings: whoever loads the plan finds every file of mine, or every file of the tool."""
    copied = copy_plan("kuka", tmp_path)
    for path in copied:
        path.write_text(path.read_text() + "# mine\n")
    replace, left = os.replace, [stop]

    def killed(old, new):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        replace(old, new)

    with monkeypatch.context() as patched:
        patched.setattr(atomic_write.os, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            copy_plan("kuka", tmp_path, force=True)
    load(copied[0])
    assert len({path.read_text().endswith("# mine\n") for path in copied}) == 1


def test_an_unknown_plan_is_named_with_the_choices():
    with pytest.raises(ConfigError, match="no plan 'paint'.*kuka.*quick"):
        copy_plan("paint")


def test_the_bare_command_shows_what_people_do_first():
    done = CliRunner().invoke(app, [])
    assert done.exit_code == 0
    for command in ("mbcacq run kuka --dry-run", "mbcacq plan copy kuka", "mbcacq report DATA"):
        assert command in done.output


def test_a_run_without_a_plan_or_a_folder_to_go_on_with_is_refused():
    done = CliRunner().invoke(app, ["run"])
    assert done.exit_code == 2
    assert "kuka" in done.stderr
    done = CliRunner().invoke(app, ["run", "--resume", "nowhere"])
    assert done.exit_code == 2
    assert "nowhere holds no run" in done.stderr
