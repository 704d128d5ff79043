"""A fake controller in a process of its own: begun, given what it needs, and ended."""

from __future__ import annotations

import json
import subprocess
import sys
from abc import abstractmethod
from typing import Any, Self

from mbcacq_fakes.protocols.started import Started

ENDS_IN_S = 5.0


class ControllerProcess(Started):
    """Context manager. The process runs a module, and talks in lines of JSON on its standard input and output."""

    _process: subprocess.Popen[str] | None = None

    @abstractmethod
    def _start(self) -> None:
        """Make what the process shares, and run it. Raises RuntimeError where it does not start."""

    @abstractmethod
    def _release(self) -> None:
        """Give back what the process shared. Idempotent."""

    def start(self) -> Self:
        """Returns when the controller runs. Raises RuntimeError if it does not start."""
        if self._process is not None:
            return self
        try:
            self._start()
        except BaseException:
            self.stop()
            raise
        return self

    def _run(self, module: str) -> None:
        # A group of its own: Ctrl-C in a terminal reaches it not even while it starts.
        self._process = subprocess.Popen(
            [sys.executable, "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )

    def _ask(self, message: dict[str, Any]) -> str:
        """A line to the process, and its answer; '' where it has ended. Raises RuntimeError where it does not run."""
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            raise RuntimeError("the fake controller does not run")
        process.stdin.write(json.dumps(message) + "\n")
        process.stdin.flush()
        return process.stdout.readline()

    def stop(self) -> None:
        """End the process. Idempotent."""
        process, self._process = self._process, None
        if process is not None:
            try:
                process.communicate(timeout=ENDS_IN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        self._release()
