"""Ctrl-C ends a command once, from its first line to its last, also where Python or a library would lose the exception."""

import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from mbcacq.cli import signals
from mbcacq.devices import signals_deferred
from mbcacq.errors import Aborted

COMMAND = """
import atexit, signal, sys, time
from mbcacq import cli
from mbcacq.cli import app
sys.path.insert(0, {folder!r})
def ctrl_c():
    signal.raise_signal(signal.SIGINT)
class Held:
    def __del__(self):
        ctrl_c()
def dropped_by_a_finaliser():
    Held()
    time.sleep(60)
def lost_in_an_import():
    import extension
    time.sleep(60)
def turned_into_another_error():
    import click
    @click.command("drivers")
    def command():
        try:
            ctrl_c()
        except KeyboardInterrupt:
            raise ImportError("initialization failed")
    sys.argv[1:] = ["drivers"]
    app.LazyGroup.get_command = lambda *_: command
    group()
group, app.app = app.app, {command}
{more}
cli.main()
"""
EXTENSION = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except BaseException:
    raise ImportError("initialization failed")
"""


@pytest.mark.parametrize(
    ("command", "more", "code", "said"),
    [
        ("ctrl_c", "", 130, "mbcacq: interrupted\n"),
        ("ctrl_c", "atexit.register(ctrl_c)", 130, "mbcacq: interrupted\n"),
        ("list", "atexit.register(ctrl_c)", 0, ""),
        ("dropped_by_a_finaliser", "", 130, "mbcacq: interrupted\n"),
        ("lost_in_an_import", "", 130, "mbcacq: interrupted\n"),
        ("turned_into_another_error", "", 130, "mbcacq: interrupted\n"),
    ],
    ids=["before-its-first-line", "again-while-it-ends", "all-done", "finaliser", "import", "another-error"],
)
def test_ctrl_c_ends_a_command_by_its_sentence_wherever_it_strikes(tmp_path, command, more, code, said):
    (tmp_path / "extension.py").write_text(EXTENSION)
    program = COMMAND.format(folder=str(tmp_path), command=command, more=more)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=900)
    assert (done.returncode, done.stderr) == (code, said)


def test_a_second_signal_does_not_disturb_the_closing_but_counts_where_that_hangs(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(signals, "time", SimpleNamespace(monotonic=lambda: now[0]))
    handler = signals.FirstSignal("the run")
    assert handler.came() is None
    with pytest.raises(Aborted, match="the run was ended by SIGTERM"):
        handler(signal.SIGTERM, None)
    handler(signal.SIGINT, None)
    handler(signal.SIGTERM, None)
    assert isinstance(handler.came(), Aborted)
    now[0] += signals.PATIENCE_S
    with pytest.raises(KeyboardInterrupt):
        handler(signal.SIGINT, None)


def test_a_signal_that_is_deferred_comes_when_all_is_made():
    made = []

    @signals_deferred()
    def make():
        signal.raise_signal(signal.SIGINT)
        made.append("whole")

    with pytest.raises(KeyboardInterrupt):
        make()
    assert made == ["whole"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
