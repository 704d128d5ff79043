"""A command whose standard streams are closed does its work, and nothing that a library says gets into a file."""

import subprocess
import sys

import pytest

SCRIPT = """
import os, sys
from mbcacq.cli import _open_standard_streams
_open_standard_streams()
kept = open(sys.argv[1], "w")
print("said", file=sys.stderr)
print("said")
os.write(1, b"by a library")
os.write(2, b"by a library")
print(repr(sys.stdin.read()), kept.fileno() > 2, file=kept)
kept.close()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors are closed by a shell of POSIX")
@pytest.mark.parametrize("closed", ["2>&-", "1>&-", "0<&-", "0<&- 1>&- 2>&-"])
def test_closed_streams_go_nowhere(tmp_path, closed):
    kept = tmp_path / "kept"
    done = subprocess.run(["sh", "-c", f'"$0" -c "$1" "$2" {closed}', sys.executable, SCRIPT, kept], stdin=subprocess.DEVNULL, timeout=120)
    assert done.returncode == 0
    assert kept.read_text() == "'' True\n"
