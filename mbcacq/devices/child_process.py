"""A Python module that runs in a process of its own and talks over pipes: started, asked, ended."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any


def _write_line(message: Any, pipe: IO[bytes]) -> None:
    pipe.write(json.dumps(message).encode() + b"\n")


class ChildEnded(Exception):
    """The process does not run, or has ended before it answered."""


class ChildProcess:
    """Python with these words as its command line, such as ``-m`` and a module. It ends when its input does.

    It leads a group of its own, so that Ctrl-C in a terminal reaches it not even while it starts.

    Parameters
    ----------
    *words : str
        Of the command line.
    dump, load : Callable
        How a message is written to a pipe and read from it: ``dump(message, pipe)``, ``load(pipe)``. By default a line of JSON.
    **started : Any
        As ``subprocess.Popen`` takes them.

    Examples
    --------
    >>> child = ChildProcess("-m", "mbcacq_kuka.rsi.cycle")
    >>> child.ask({"port": 0})
    {'ready': 49152, 'real_time': False}
    >>> child.end(5.0)
    """

    def __init__(
        self,
        *words: str,
        dump: Callable[[Any, IO[bytes]], object] = _write_line,
        load: Callable[[IO[bytes]], Any] = lambda pipe: json.loads(pipe.readline()),
        **started: Any,
    ) -> None:
        self._dump, self._load = dump, load
        self._process: subprocess.Popen[Any] = subprocess.Popen(
            [sys.executable, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, **started
        )
        assert self._process.stdin is not None  # both are pipes
        assert self._process.stdout is not None
        self.input, self.output = self._process.stdin, self._process.stdout

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def send(self, message: Any) -> None:
        """Raises ChildEnded."""
        try:
            self._dump(message, self.input)
            self.input.flush()
        except (OSError, ValueError) as error:  # ValueError: closed by ``end``
            raise ChildEnded from error

    def receive(self) -> Any:
        """The next message of the process. Raises ChildEnded."""
        try:
            return self._load(self.output)
        except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
            raise ChildEnded from error

    def ask(self, message: Any) -> Any:
        """Send, and wait for the answer. Raises ChildEnded."""
        self.send(message)
        return self.receive()

    def kill(self) -> None:
        """End it at once, and what it has started."""
        kill(self._process)

    def end(self, wait_s: float) -> None:
        """Close its input; kill it where it still runs after ``wait_s``. Idempotent."""
        with suppress(OSError, ValueError):  # a message that it did not take
            self.input.close()
        try:
            self._process.wait(wait_s)
        except subprocess.TimeoutExpired:
            self.kill()
            self._process.wait()
        self.output.close()


def kill(process: subprocess.Popen) -> None:
    """Kill a process. On POSIX one that leads a group of its own is killed with it; Windows has no such groups."""
    if process.poll() is not None:
        return
    if sys.platform == "win32":
        process.kill()
        return
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        process.kill()
