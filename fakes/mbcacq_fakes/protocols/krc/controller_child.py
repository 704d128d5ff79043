"""What runs in the process of a fake controller: begun and commanded by lines of JSON. It imports little, for each start waits for it."""

from __future__ import annotations

import json
import signal
import sys
import threading
from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Callable, Mapping
from typing import Any

from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.krl.values import KrlError


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
