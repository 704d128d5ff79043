"""A fake controller in a process of its own: begun, given what it needs, and ended."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Self

from mbcacq.devices import ChildEnded, ChildProcess
from mbcacq_fakes.protocols.started import Started

ENDS_IN_S = 5.0


class ControllerProcess(Started):
    """Context manager. The process runs a module, and talks in lines of JSON on its standard input and output."""

    _process: ChildProcess | None = None

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
        self._process = ChildProcess("-m", module)

    def _ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """What the process answers. Raises RuntimeError where it does not run, or has ended."""
        if self._process is None:
            raise RuntimeError("the fake controller does not run")
        try:
            return self._process.ask(message)
        except ChildEnded:
            raise RuntimeError("the fake controller's process has ended") from None

    def stop(self) -> None:
        """End the process. Idempotent."""
        process, self._process = self._process, None
        if process is not None:
            process.end(ENDS_IN_S)
        self._release()
