"""The rerun program that comes with the wheel: for its ``rrd`` commands and its viewer."""

from __future__ import annotations

import importlib.util
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from mbcacq.devices import kill
from mbcacq.errors import RecordingError
from mbcacq.recording.rrd.quiet_environment import quiet_environment

MOST_SAID = 1 << 16  # characters


def program() -> str:
    """The executable itself. The ``rerun`` script is a wrapper whose end does not end the viewer, so it is not used."""
    if override := os.environ.get("RERUN_CLI_PATH"):
        return override
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.submodule_search_locations[0]) if spec and spec.submodule_search_locations else Path("rerun_cli")
    names = ["rerun.exe"] if sys.platform == "win32" else ["Rerun.app/Contents/MacOS/Rerun", "rerun"]
    found = next((folder / name for name in names if (folder / name).exists()), None)
    if found is None:
        raise RecordingError(f"the rerun program is missing in {folder}; reinstall rerun-sdk")
    return str(found)


def free_port(preferred: int = 0) -> int:
    """The preferred port of this computer, or any free one if it is taken: rerun would only notice in a thread of its own."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
                return probe.getsockname()[1]
            except OSError:
                continue
    raise OSError("no free port on 127.0.0.1")


def started(arguments: Sequence[str], environment: dict[str, str], out: int, err: int) -> subprocess.Popen[str]:
    """The program, begun, in a group of its own (POSIX), which keeps signals apart. out, err: as ``subprocess.Popen`` takes them."""
    return subprocess.Popen(
        [program(), *arguments],
        stdout=out,
        stderr=err,
        stdin=subprocess.DEVNULL,
        text=True,
        errors="replace",
        start_new_session=True,
        env=environment,
    )


def run(arguments: Sequence[str], timeout_s: float = 600.0) -> subprocess.CompletedProcess[str]:
    """Run the program to its end; it and its children are killed when the time is over. The beginning of what it says is kept: on a damaged
    file it may repeat an error without end."""
    with quiet_environment() as environment, ExitStack() as stack:
        child = stack.enter_context(started(arguments, environment, subprocess.PIPE, subprocess.STDOUT))
        stack.callback(kill, child)
        over = threading.Event()
        late = threading.Timer(timeout_s, lambda: (over.set(), kill(child)))
        stack.callback(late.cancel)
        late.start()
        assert child.stdout is not None, "it is a pipe"
        said = child.stdout.read(MOST_SAID)
        while child.stdout.read(MOST_SAID):
            pass
        child.wait()
    if over.is_set():
        raise RecordingError(f"rerun {' '.join(arguments[:2])} did not end within {timeout_s:g} s and was stopped")
    return subprocess.CompletedProcess(child.args, child.returncode, said)


def error_line(result: subprocess.CompletedProcess[str]) -> str:
    """The line of the output that names the error, without colours and time stamps."""

    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in (result.stderr or result.stdout or "").splitlines()]
    lines = [line for line in lines if line]
    errors = [line for line in lines if "rror" in line or "panicked" in line]
    return (errors or lines or [f"exit status {result.returncode}"])[0][:200]
