"""A fake controller in a process of its own: begun, commanded by lines of JSON, and ended."""

from __future__ import annotations

import json
import signal
import sys
import threading
from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

import numpy as np

from mbcacq.devices import ChildEnded, ChildProcess, signals_deferred
from mbcacq_fakes.protocols.faults import Faults, refuse_unknown
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.krl.values import KrlError
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


class KukaController(ABC):
    """What runs in the process. ``faults`` and ``led`` change while it runs; ``led`` is where a person moves the arm, deg, or None."""

    port: int

    def __init__(self, known: Mapping[str, str], given: Mapping[str, float]) -> None:
        self.faults = Faults(known)
        self.faults.inject(given)
        self.led: tuple[float, ...] | None = None

    @abstractmethod
    def run(self, gone: threading.Event) -> None:
        """Until whoever started the process is gone."""

    @abstractmethod
    def report(self) -> dict[str, Any]: ...

    @abstractmethod
    def close(self) -> None: ...

    def log(self) -> bytes:
        """What was logged, in binary numbers."""
        return b""

    def obey(self, command: Mapping[str, Any]) -> dict[str, Any]:
        self.faults.inject(command.get("faults", {}))
        if "lead" in command:
            self.led = tuple(command["lead"])
        return {"log": b64encode(self.log()).decode()} if "log" in command else self.report()


def serve(make: Callable[[dict[str, Any], ArmState], KukaController]) -> int:
    """Main of the process. make: the controller, of its settings and the state that it publishes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not (line := sys.stdin.readline()):
        return 0  # whoever started this was interrupted
    start, gone = json.loads(line), threading.Event()
    state = ArmState.attach(start["state"])
    try:
        controller = make(start["settings"], state)
    except (KrlError, ValueError, OSError) as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 1

    def listen() -> None:
        for line in sys.stdin:
            print(json.dumps(controller.obey(json.loads(line))), flush=True)
        gone.set()

    print(json.dumps({"port": controller.port}), flush=True)
    threading.Thread(target=listen, daemon=True).start()
    try:
        controller.run(gone)
    finally:
        controller.close()
        state.close()
    return 0
