"""A fake controller in a process of its own: begun, commanded by lines of JSON, and ended."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from mbcacq.devices import ChildEnded, ChildProcess, signals_deferred
from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.started import Started

ENDS_IN_S = 5.0


class ControllerProcess(Started):
    """Context manager. settings: what the process is set up with. state: an ArmState to publish the arm in, or None for one of its own.

    ``state`` is that ArmState, ``port`` where the controller can be reached.
    """

    module: ClassVar[str]
    known_faults: ClassVar[Mapping[str, str]]

    def __init__(self, settings: Any, state: ArmState | None) -> None:
        self.settings, self.port = settings, 0
        self._given = self.state = state
        self._process: ChildProcess | None = None
        self._lock = threading.Lock()

    def start(self) -> Self:
        """Returns when the controller runs. Raises RuntimeError if it does not start."""
        if self._process is not None:
            return self
        try:
            if self.state is None:
                with signals_deferred():
                    self.state = ArmState.create(self.settings.start)
            self._process = ChildProcess("-m", self.module)
            answer = self._ask(settings=self.settings.to_json(), state=self.state.name)
            if "error" in answer:
                raise RuntimeError(f"the fake controller did not start: {answer['error']}")
        except BaseException:
            self.stop()
            raise
        self.port = answer["port"]
        return self

    def stop(self) -> None:
        """End the process. Idempotent."""
        process, self._process = self._process, None
        if process is not None:
            process.end(ENDS_IN_S)
        if self.state is not None and self._given is None:
            self.state.close()
            self.state = None

    def inject(self, **faults: float) -> None:
        """Set faults while running, by name; 0 or False takes one back. See ``known_faults``."""
        refuse_unknown(faults, self.known_faults)
        self._ask(faults={name: float(value) for name, value in faults.items()})

    def lead(self, target: np.ndarray) -> None:
        """A person, or another program on the controller, moves the arm to ``target`` (6,) rad."""
        self._ask(lead=np.degrees(target).tolist())

    def report(self) -> dict[str, Any]:
        """What the controller has counted so far."""
        return self._ask()

    def _ask(self, **message: Any) -> dict[str, Any]:
        """What the process answers. Raises RuntimeError if it does not run, or has ended."""
        with self._lock:
            if self._process is None:
                raise RuntimeError("the fake controller does not run")
            try:
                return self._process.ask(message)
            except ChildEnded:
                raise RuntimeError("the fake controller's process has ended") from None
