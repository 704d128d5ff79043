"""Commands that take long say what they do; tables fit a terminal; what is heavy is loaded only where it is used."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from mbcacq.cli import step_progress
from mbcacq.cli.app import app
from mbcacq.cli.step_progress import StepProgress

ROOT = Path(__file__).parents[2]


def ticking(monkeypatch, capfd, terminal: bool) -> str:
    """What is written while a step lasts over many ticks of a fast clock."""
    monkeypatch.setattr(step_progress, "EVERY_S", 0.02)
    monkeypatch.setattr(step_progress.signal, "getsignal", lambda number: step_progress.signal.SIG_DFL)  # pytest-timeout has its own alarm
    ticks = []
    tick = StepProgress._tick
    monkeypatch.setattr(StepProgress, "_tick", lambda self: (ticks.append(1), tick(self))[1])
    with StepProgress() as progress:
        progress._terminal = terminal
        progress("calibrating")
        progress.begin("drawing")
        end = time.monotonic() + 600.0
        while len(ticks) < 20 and time.monotonic() < end:
            time.sleep(0.02)
    return capfd.readouterr().err


def test_a_long_step_is_named_again_on_a_terminal_while_it_lasts(monkeypatch, capfd):
    assert "drawing: 0 s so far" in ticking(monkeypatch, capfd, True)


def test_a_file_or_a_pipe_gets_one_line_a_step(monkeypatch, capfd):
    assert ticking(monkeypatch, capfd, False) == "calibrating ...\ndrawing ...\n"


def test_a_step_that_comes_again_has_no_second_line(capfd, monkeypatch):
    clock = iter(range(100))
    monkeypatch.setattr(step_progress.time, "monotonic", lambda: float(next(clock)) * 10)
    progress = StepProgress()
    progress._terminal = False
    for _ in range(3):
        progress.printed("checking every path")
        progress._tick()
    progress.printed("61 poses")
    assert capfd.readouterr().err == "checking every path\n61 poses\n"


def test_of_many_parts_a_file_gets_the_first_the_last_and_every_tenth(capfd):
    progress = StepProgress()
    for part in range(1, 201):
        progress(f"pose {part} of 200")
    said = [line.split(",")[0].removesuffix(" ...") for line in capfd.readouterr().err.splitlines()]
    assert said == [f"pose {part} of 200" for part in (1, *range(20, 201, 20))]


@pytest.mark.parametrize("columns", [20, 40, 80])
def test_a_terminal_breaks_lines_between_words(columns):
    from mbcacq.cli.step_progress import shortened
    from mbcacq.cli.terminal import wrapped

    text = "  simulated: the fake cell or a model made these data, no real arm was measured\nshort"
    lines = wrapped(text, columns).split("\n")
    assert max(map(len, lines)) <= columns
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())
    assert all(line.startswith("    ") for line in lines[1:-1])
    assert wrapped("/a/path/that/is/longer/than/the/terminal/is/wide", 20) == "/a/path/that/is/longer/than/the/terminal/is/wide"
    cut = shortened(text.split("\n")[0], columns)
    assert len(cut) <= columns
    assert text.startswith(cut.removesuffix("…"))


def test_the_time_left_follows_from_the_parts_done(monkeypatch, capfd):
    clock = iter([0.0, 10.0, 20.0])
    monkeypatch.setattr(step_progress.time, "monotonic", lambda: next(clock))
    progress = StepProgress()
    for part in (1, 2, 3):
        progress(f"part {part} of 4")
    said = capfd.readouterr().err.splitlines()
    assert said == ["part 1 of 4 ...", "part 2 of 4, about 30 s left ...", "part 3 of 4, about 20 s left ..."]


def commands(group=app, above=()):
    """Every command with its names, groups and their commands alike."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*above, name)
        if isinstance(command, click.Group):
            yield from commands(command, (*above, name))


@pytest.mark.parametrize("command", list(commands()), ids=" ".join)
def test_the_help_of_every_command_fits_eighty_columns(command):
    done = CliRunner().invoke(app, [*command, "--help"], terminal_width=80)
    assert done.exit_code == 0
    assert [line for line in done.output.splitlines() if len(line) > 80] == []


def test_the_list_of_drivers_fits_eighty_columns():
    done = CliRunner().invoke(app, ["drivers"])
    assert max(map(len, done.output.splitlines())) <= 80


def test_the_table_of_challenges_fits_eighty_columns(monkeypatch, capsys):
    from mbcacq.challenge.table import COLUMNS
    from mbcacq.cli.challenge import table_of
    from mbcacq.cli.declared import Answer

    monkeypatch.setenv("COLUMNS", "80")
    row = dict.fromkeys(COLUMNS, 1.0) | {"kind": "gear_transmission_error, joint_compliance", "challenges": 1000, "that count": 1000}
    Answer({}, [table_of([row])]).say(as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert "transmission" in " ".join(lines)


@pytest.mark.parametrize(
    "modules",
    [
        ["mbcacq.workflow.run", "mbcacq.recording.rrd.writer", "mbcacq.spheres.extract", "mbcacq_fakes.cell.fake_cell"],
        ["mbcacq.workflow.calibrate", "mbcacq.workflow.diagnose", "mbcacq.workflow.report", "mbcacq.recording.viewer.open_viewer"],
    ],
    ids=["run", "evaluate"],
)
def test_what_needs_no_point_cloud_file_loads_no_open3d(modules):
    code = f"import sys, {', '.join(modules)}\nfor name in [m for m in sys.modules if m.startswith('mbcacq')]: pass\nprint(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ}).stdout.split()
    assert not {m for m in out if m.split(".")[0] in ("open3d", "dash", "IPython")}
