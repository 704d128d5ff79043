"""The cycle process as the driver sees it: started, commanded, read, ended. It holds one RSI session."""

from __future__ import annotations

import threading
from typing import Any

from mbcacq.devices import ChildEnded, ChildProcess, Cycles
from mbcacq_kuka.rsi.record import CycleReader
from mbcacq_kuka.rsi.shared import CLOSE, RsiCommand, Shared

_BRAKING_S = 8.0  # the process may take so long until the arm stands


class CycleProcess:
    """Safe to use from several threads. ``port`` and ``real_time`` are known after ``start``."""

    def __init__(self) -> None:
        """Raises OSError if there is no shared memory left."""
        self._shared: Shared | None = Shared.create()
        self._reader = CycleReader(self._shared)
        self._lock = threading.Lock()
        self._process: ChildProcess | None = None
        self.port, self.real_time = 0, False

    def start(self, settings: dict[str, Any]) -> str:
        """'' once it listens, else why it cannot."""
        assert self._shared is not None  # start comes before close
        process = self._process = ChildProcess("-m", "mbcacq_kuka.rsi.cycle")
        try:
            answer = process.ask({"shared": self._shared.name, **settings})
        except ChildEnded:
            answer = {"error": "the RSI process did not start"}
        if "error" in answer:
            return answer["error"]
        self._shared.forget()
        self.port, self.real_time = answer["ready"], answer["real_time"]
        return ""

    @property
    def open(self) -> bool:
        return self._shared is not None

    @property
    def connected(self) -> bool:
        return self._shared is not None and self._shared.head > 0

    @property
    def exit_code(self) -> int | None:
        return None if self._process is None else self._process.exit_code

    @property
    def lost(self) -> int:
        """Cycles that were not fetched in time."""
        return self._reader.lost

    @property
    def start_deg(self) -> Any:
        """Axis angles (6,) at the beginning of the session, deg."""
        return self._reader.start

    def begin(self) -> None:
        """The session is connected: its telegrams' layout is known."""
        self._reader.begin()

    @property
    def decimals(self) -> int:
        """With how many decimals the controller writes joint angles."""
        return 0 if self._shared is None else self._shared.decimals

    def noted(self) -> tuple[int, str, int]:
        """How many datagrams came before a session has begun, from where the last, and how many answers the controller discarded."""
        return (0, "", 0) if self._shared is None else self._shared.noted()

    def fault(self) -> dict[str, Any] | None:
        return None if self._shared is None else self._shared.fault()

    def last(self) -> dict[str, Any]:
        with self._lock:
            return self._reader.last()

    def drain(self) -> Cycles:
        with self._lock:
            return self._reader.drain()

    def send(self, command: RsiCommand) -> int:
        """The number of the command; 0 where the session is closed."""
        with self._lock:
            return 0 if self._shared is None else self._shared.send(command)

    def switch(self, bits: int, on: bool) -> None:
        """Switch the outputs of these bits (see Shared.outputs) on or off, from one of the next answers on."""
        with self._lock:
            if self._shared is not None:
                self._shared.outputs = self._shared.outputs | bits if on else self._shared.outputs & ~bits

    def is_switched(self, bits: int) -> bool:
        """Whether the outputs of these bits are to be on."""
        return self._shared is not None and bool(self._shared.outputs & bits)

    def newest(self, name: str) -> float:
        """A value of the newest telegram, e.g. 'Digout.o3'; NaN where the session does not send it, or has ended."""
        with self._lock:
            return self._reader.newest(name)

    def close(self) -> None:
        """Brake, end the session, wait until the process has ended; cycles that were not read yet are kept for ``drain``. Idempotent."""
        process, self._process = self._process, None
        if process is not None:
            self.send(RsiCommand(CLOSE))
            process.end(_BRAKING_S)
        with self._lock:
            shared, self._shared = self._shared, None
            if shared is not None:
                self._reader.detach()
                shared.close()
