import os
import sys
import threading

import pytest
from mbcacq_bus.manual import ManualPositioner

from mbcacq.devices import Aborted, ConfigError

needs_terminal = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


@pytest.fixture
def terminal(monkeypatch):
    """A pseudo-terminal in place of standard input; yields its other end."""
    master, slave = os.openpty()
    stdin = os.fdopen(slave, "r")
    monkeypatch.setattr(sys, "stdin", stdin)
    yield master
    os.close(master)
    stdin.close()


@needs_terminal
def test_asks_and_goes_on_after_enter(terminal, capsys):
    os.write(terminal, b"\n")
    with ManualPositioner("m", "", {}) as positioner:
        positioner.go_to("3", "Put the MBC-8 on height 3.")
    assert "Put the MBC-8 on height 3." in capsys.readouterr().err


@needs_terminal
def test_q_and_stop_abort(terminal):
    os.write(terminal, b"q\n")
    positioner = ManualPositioner("m", "", {})
    positioner.connect()
    with pytest.raises(Aborted, match="station 3"):
        positioner.go_to("3", "")
    timer = threading.Timer(0.1, positioner.stop)
    timer.start()
    with pytest.raises(Aborted):
        positioner.go_to("4", "")
    timer.join()


def test_never_prompts_without_a_terminal(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(ConfigError, match="not a terminal"):
            ManualPositioner("m", "", {}).connect()
        with ManualPositioner("m", "", {"assume_yes": True}) as positioner:
            positioner.go_to("1", "")
    with pytest.raises(ConfigError, match="asume_yes"):
        ManualPositioner("m", "", {"asume_yes": True})
