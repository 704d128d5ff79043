"""The command as a user types it, and the one sentence in which a command fails."""

import sys
import time
from contextlib import chdir
from pathlib import Path
from types import SimpleNamespace

from click.testing import CliRunner

from mbcacq.cli.app import app

ROOT = Path(__file__).parents[2]
MBCACQ = Path(sys.executable).parent / "mbcacq"


def mbcacq(*args):
    """The command without a terminal, in this process, which has its libraries loaded; what must be a process of its own starts MBCACQ."""
    with chdir(ROOT):
        done = CliRunner().invoke(app, [str(arg) for arg in args])
    return SimpleNamespace(returncode=done.exit_code, stdout=done.stdout, stderr=done.stderr)


def until(condition, within_s=900.0):
    """A generous bound against hanging, not a statement about time."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.01)


def one_sentence(done):
    lines = [line for line in done.stderr.splitlines() if line.startswith("mbcacq: ")]
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.stderr
    return lines[0]
