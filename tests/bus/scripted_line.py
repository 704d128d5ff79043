"""A serial line without a thread or a clock of its own: time passes only while somebody waits for it, and answers come when the test says.

A machine that stands still for seconds changes nothing, and nobody waits in real time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from late_peers import rtu_cut
from mbcacq_bus import modbus_link, modbus_transport, serial, serial_link, stations
from pymodbus.client import serial as pymodbus_serial


class ScriptedLine:
    """A port of pyserial and the module ``time`` in one. ``answer(line heard)`` gives (s until it comes, bytes), or None; ``now``: s."""

    is_open = True

    def __init__(self, answer: Callable[[str], tuple[float, bytes] | None]) -> None:
        self._answer = answer
        self.now, self.timeout, self.heard = 0.0, 0.05, []
        self._pending, self._due, self._last = b"", [], 0.0

    # the clock

    def monotonic(self) -> float:
        return self.now

    time = monotonic

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    # the port

    def _arrived(self) -> bytes:
        self._pending += b"".join(data for at, data in self._due if at <= self.now)
        self._due = [(at, data) for at, data in self._due if at > self.now]
        return self._pending

    @property
    def in_waiting(self) -> int:
        return len(self._arrived())

    def read(self, count: int) -> bytes:
        taken, self._pending = self._arrived()[:count], self._pending[count:]
        return taken

    def read_until(self, end: bytes, most: int) -> bytes:
        found = self._arrived().find(end)
        if found < 0:
            self.now += self.timeout
            found = self._arrived().find(end)
        return self.read(min(most, found + len(end) if found >= 0 else most))

    def write(self, data: bytes) -> int:
        for line in data.split(b"\n")[:-1]:
            self._hear(line.strip().decode())
        return len(data)

    def _hear(self, asked) -> None:
        self.heard.append(asked)
        if (reply := self._answer(asked)) is not None:
            self._last = max(self._last, self.now + reply[0])  # a line brings answers in their order
            self._due.append((self._last, reply[1]))

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass

    def stopped(self) -> threading.Event:
        """An event that nobody waits for in real time."""
        line = self

        class Waited(threading.Event):
            def wait(self, timeout=None):
                line.now += timeout or 0.0
                return self.is_set()

        return Waited()

    def install(self, monkeypatch) -> None:
        """Whoever opens a serial line has this one."""
        monkeypatch.setattr(serial_link, "open_port", lambda *_, **__: self)
        for module in (serial, serial_link, stations):
            monkeypatch.setattr(module, "time", self)


class ScriptedRtu(ScriptedLine):
    """The same with the requests of Modbus RTU, as bytes."""

    def write(self, data: bytes) -> int:
        assert rtu_cut(data) == len(data)  # pymodbus writes one request at a time
        self._hear(data)
        return len(data)

    def install(self, monkeypatch) -> None:
        """Whoever opens a line for Modbus has this one."""
        monkeypatch.setattr(modbus_transport, "open_port", lambda *_, **__: self)
        for module in (modbus_link, modbus_transport, pymodbus_serial):
            monkeypatch.setattr(module, "time", self)
