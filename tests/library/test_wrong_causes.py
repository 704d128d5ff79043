"""A mistake is answered by its own cause, and never by one that happens to be checked first."""

import ast
import re
import shlex
import shutil
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import mbcacq.cli
from mbcacq.calibration.result_io import export_command
from mbcacq.cli.app import COMMANDS, app
from mbcacq.cli.export import next_step
from mbcacq.cli.run_path import judge_first

CLI = Path(mbcacq.cli.__file__).parent
PLANS = Path(__file__).parents[2] / "plans"
MOUNT_MM, MOUNT_M = "translation_mm: [1.2621, -0.5610, 264.7998]", "translation_mm: [0.0012621, -0.0005610, 0.2647998]"


@pytest.fixture
def plan(tmp_path):
    """Writes the shipped quick plan with something replaced; its path."""

    def write(old, new):
        for folder in ("robots", "artefacts"):
            shutil.copytree(PLANS / folder, tmp_path / folder, dirs_exist_ok=True)
        text = (PLANS / "quick.yaml").read_text(encoding="utf-8")
        assert old in text
        (tmp_path / "quick.yaml").write_text(text.replace(old, new, 1), encoding="utf-8")
        return tmp_path / "quick.yaml"

    return write


def said(*arguments):
    done = CliRunner().invoke(app, [str(one) for one in arguments])
    assert "Traceback" not in done.stderr
    assert "bug" not in done.stderr
    return done.exit_code, done.stderr


@pytest.mark.parametrize("name", ["missing.csv", "missing.urdf", "missing.yaml", "missing.xml"])
def test_a_file_that_is_not_there_is_not_asked_about_its_content(name, tmp_path):
    code, words = said("robot", "import", tmp_path / name)
    assert code == 2
    assert f"{name} does not exist" in words
    assert "convention" not in words


def test_a_plan_of_a_newer_format_is_not_called_wrong(plan):
    code, words = said("plan", "check", plan("mbcacq-plan/1", "mbcacq-plan/2"))
    assert code == 2
    assert "written by a newer mbcacq" in words
    assert "correct" not in words


def test_a_mount_in_metres_is_not_called_a_collision(plan):
    path = plan(MOUNT_MM, MOUNT_M)
    code, words = said("plan", "check", path)
    assert code == 2
    assert "looks like metres; give translation_mm in mm" in words
    assert "link" not in words


def test_a_fleet_names_its_extra_before_it_is_missed(tmp_path, monkeypatch):
    assert "mbcacq[fleet]" in CliRunner().invoke(app, ["fleet", "--help"]).stdout
    monkeypatch.setitem(sys.modules, "dask", None)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "arms.csv").write_text("recording,arm,time\n" + f"{tmp_path},one,2026-01-01\n")
    code, words = said("fleet", tmp_path / "runs" / "arms.csv", "--out", tmp_path / "fleet")
    assert code == 2
    assert "pip install 'mbcacq[fleet]'" in words


def test_a_view_says_which_pose_it_shows_by_the_number_that_everything_else_has():
    """'pose N' is the number of plan show and of the recording, from 0; a count is 'k of n poses'."""
    sources = CLI.parent.rglob("*.py")
    assert [str(file) for file in sources if re.search(r"pose \{[^}]*number \+ 1", file.read_text(encoding="utf-8"))] == []


def commands(group=app, words=()):
    context = click.Context(group)
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        assert found is not None
        if isinstance(found, click.Group):
            yield from commands(found, (*words, name))
        else:
            yield (*words, name), found


def parses(line):
    """Whether a line of the terminal is a command that this program has, with options and arguments that it takes."""
    words, found = shlex.split(line)[1:], app
    while isinstance(found, click.Group):
        found = found.get_command(click.Context(found), words.pop(0))
    found.make_context(found.name, words)
    return True


DOCUMENTS = {"schema", "diagnosis-schema"}  # what they print is a file, and nothing else
FOREGROUND = {"serve"}  # it goes on until it is ended


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - DOCUMENTS - FOREGROUND))
def test_every_command_has_a_next_step(name):
    plain = name.replace("-", "_")
    for file in (CLI / f"{plain}.py", *CLI.glob(f"{plain}_*.py")):
        source = ast.parse(file.read_text(encoding="utf-8"))
        calls = [call for call in ast.walk(source) if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)]
        answers = [call for call in calls if call.func.id == "Answer" and not any(word.arg == "end" for word in call.keywords)]
        assert all(len(call.args) > 2 or any(word.arg == "then" for word in call.keywords) for call in answers)
        said = {call.func.id for call in calls}
        assert "subcommand" not in said or said & {"Answer", "answer_of_run", "say_next"}


NOTHING_RUNS = [
    ("drivers",),
    ("doctor",),
    ("plan", "copy", "kuka", "my cell"),
    ("plan", "check", "quick", "--quick"),
    ("plan", "show", "quick"),
    ("controller-files", "quick", "--out", "files"),
    ("simulate", "quick", "--out", "a twin"),
]


@pytest.mark.parametrize("arguments", NOTHING_RUNS, ids=" ".join)
def test_the_last_line_is_one_command_that_can_be_pasted(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code in (0, 2), done.stderr
    last = done.stderr.splitlines()[-1]
    assert done.stderr.count("next:") == 1
    found = re.fullmatch(r"next: (.+?): (mbcacq .+)", last)
    assert found, last
    assert parses(found[2])


def test_the_next_step_of_a_result_by_itself_is_a_command_about_it(tmp_path):
    """Not the help of another command; the result in a run's folder leads to the report of the run."""
    alone = tmp_path / "alone.json"
    alone.touch()
    assert judge_first(alone)[1] == f"mbcacq verify {alone} OTHER"
    results = tmp_path / "results"
    results.mkdir()
    (results / "arm.mjcf.xml").touch()
    assert next_step(alone, None, results)[1] == f"mbcacq robot import {results / 'arm.mjcf.xml'} --speed 30 --out calibrated-arm.yaml"
    run = tmp_path / "run"
    (run / "with-effects").mkdir(parents=True)
    for name in ("run.rrd", "result.json", "with-effects/result.json"):
        (run / name).touch()
    for result in (run, run / "result.json", run / "with-effects", run / "with-effects" / "result.json"):
        assert judge_first(result)[1] == f"mbcacq report {run}"
        assert next_step(result, None, results)[1] == f"mbcacq report {run}"


def test_the_next_step_of_a_certificate_is_a_plan_and_of_a_motion_its_diagnosis(tmp_path):
    """Neither can be looked at in the viewer."""
    certificate = tmp_path / "certificate.csv"
    certificate.touch()
    assert next_step(certificate, None, None, artefact="four.yaml")[1].endswith(" --artefact four.yaml")
    assert next_step(certificate, None, None, trajectory=Path("motion"))[1] == "mbcacq diagnose motion"


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        (["runn", "kuka"], "did you mean run?"),
        (["diagnos", "x"], "did you mean diagnose"),
        (["run", "plans/quik.yaml"], "did you mean quick?"),
        (["run", "my-cel.yaml"], "did you mean my-cell.yaml?"),
    ],
)
def test_a_name_that_is_almost_right_is_answered_by_the_right_one(typed, meant, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my-cell.yaml").touch()
    done = CliRunner().invoke(app, typed)
    assert done.exit_code == 2
    assert meant in done.stderr.replace("\n", " ")


def test_the_next_step_of_a_simulated_result_is_not_refused(tmp_path):
    """Its export has to be meant; the command that is shown says so."""
    for simulated, option in ((True, " --simulated-anyway"), (False, "")):
        assert export_command({"simulated": simulated}, tmp_path) == f"mbcacq export {tmp_path} --results results{option}"
        assert parses(export_command({"simulated": simulated}, tmp_path))


def test_a_plan_that_lies_here_is_meant_before_the_one_of_the_same_name_that_came_with_the_tool(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kuka.yaml").write_text("format: mbcacq-plan/1\nname: mine\n", encoding="utf-8")
    done = CliRunner().invoke(app, ["plan", "check", "kuka"])
    assert done.exit_code == 2
    assert "kuka is kuka.yaml, which lies here" in done.stderr
    assert "robot" in done.stderr  # of which this one has none
