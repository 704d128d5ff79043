"""Nothing that comes from outside reaches the terminal as a command to it."""

import io
import re
import sys
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from rich.table import Table

from mbcacq.acquisition import events
from mbcacq.cli.app import app
from mbcacq.cli.progress import RunProgress
from mbcacq.cli.terminal import console, echo, printable

CLI = Path(__file__).parents[2] / "mbcacq" / "cli"
EVIL = "gocator\x1b]0;owned\x07\x1b[2J\x9b31m\rmbcacq: fine\u202e"


def test_control_characters_become_visible():
    assert printable(EVIL) == r"gocator\x1b]0;owned\x07\x1b[2J\x9b31m\rmbcacq: fine\u202e"
    assert printable("Küche\t1 µm\nnext") == "Küche\t1 µm\nnext"


def test_an_error_with_a_foreign_name_is_shown_as_text(tmp_path):
    done = CliRunner().invoke(app, ["calibrate", str(tmp_path / f"a{EVIL}b")])
    assert done.exit_code == 2
    assert r"\x1b]0;owned\x07" in done.stderr
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f]", done.stderr)


def test_the_string_of_a_device_in_the_progress_is_shown_as_text(capsys):
    progress = RunProgress()
    progress(events.Message(0.0, "warning", f"scanner: {EVIL} [/bold]"))
    shown = capsys.readouterr().err
    assert r"\x1b[2J" in shown
    assert "[/bold]" in shown
    assert "\x1b" not in shown


@pytest.mark.parametrize("terminal", [True, False])
def test_a_table_shows_foreign_cells_as_text_and_keeps_its_own_colours(terminal):
    file = io.StringIO()
    table = Table(title=f"[red]{EVIL}")
    table.add_column("station", style="red")
    table.add_row(f"[bold]{EVIL}")
    console(file=file, force_terminal=terminal, width=200, color_system="standard" if terminal else None).print(table)
    text = file.getvalue()
    assert "\x1b]0" not in text
    assert "\x1b[2J" not in text
    assert "[bold]gocator" in text
    assert ("\x1b[31m" in text) is terminal


def test_a_label_keeps_its_colour(capsys, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    echo(f" {EVIL}", label=("error", "red"))
    assert capsys.readouterr().out.startswith(click.style("error", fg="red") + r" gocator\x1b]0")


def test_every_command_prints_through_the_filter():
    for path in CLI.glob("*.py"):
        if path.name != "terminal.py":
            assert not re.search(r"click\.s?echo|click\.secho|(?<!\.)\bprint\(|import Console", path.read_text()), (
                f"{path.name} prints past the filter of control characters; print by echo of mbcacq.cli.terminal"
            )


def test_a_step_with_brackets_in_its_name_is_no_markup(capsys):
    progress = RunProgress()
    progress(replace(events.RunStarted(0.0, "x", "", "", "", 1, {})))
    progress(events.StepStarted(0.0, 0, "[/step]", 1))
    progress(events.RunStopped(1.0, "success", "done [/]"))
    assert "done [/]" in capsys.readouterr().err
