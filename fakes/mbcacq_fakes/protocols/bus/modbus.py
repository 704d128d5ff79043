"""A fake Modbus TCP server with a positioner and sensors behind it.

pymodbus calls its simulator experimental and changes it; everything that depends on it is in ``FakeModbus``.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

from mbcacq_bus.registers import Register
from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from mbcacq_fakes.protocols.started import Started

SIZE = 1024  # registers, and bits, served of each table
_TABLE = {1: "coil", 5: "coil", 15: "coil", 2: "discrete", 4: "input"}  # by function code; all others are holding registers


@dataclass
class FakePositioner:
    """Drives to a commanded position in ``travel_s``; its flag is down meanwhile. Faults: ``stuck`` never arrives, ``fault`` a code.

    Registers are None if it is not driven over Modbus.
    """

    stations: dict[str, float]
    position: Register | None = None
    in_position: Register | None = None
    actual: Register | None = None
    fault_register: Register | None = None
    travel_s: float = 0.05
    stuck: bool = False
    fault: int = 0
    target: float | None = None
    began: float = -1e9

    def written(self, value: float) -> None:
        self.target, self.began = value, time.monotonic()

    @property
    def arrived(self) -> bool:
        return not self.stuck and time.monotonic() - self.began >= self.travel_s

    @property
    def station(self) -> str | None:
        """The station at the commanded position, None while it moves or stands elsewhere."""
        if self.target is None or not self.arrived:
            return None
        target = self.target
        nearest = min(self.stations, key=lambda s: abs(self.stations[s] - target))
        return nearest if abs(self.stations[nearest] - target) < 0.5 else None

    def outputs(self) -> list[tuple[Register, float]]:
        live = [] if self.in_position is None else [(self.in_position, float(self.arrived))]
        if self.actual is not None:
            live.append((self.actual, self.target if self.arrived and self.target is not None else -999.0))
        if self.fault_register is not None:
            live.append((self.fault_register, float(self.fault)))
        return live


class _Server(ModbusTcpServer):
    """Ends without leaving a connection half made: asyncio loses one that is being accepted while its server closes."""

    async def end(self) -> None:
        await asyncio.sleep(0.02)
        self.close()
        await asyncio.sleep(0.02)
        if not self.serving.done():
            self.serving.set_result(True)


@dataclass
class FakeModbus(Started):
    """Serves a positioner and any number of live registers on 127.0.0.1. ``address`` is known once started.

    values: pairs of a register and a function giving its value now. silent: fault, answers nothing.
    rtu: serial framing on the TCP port, as behind a serial server. sent, received: bytes on the wire.
    """

    positioner: FakePositioner | None = None
    values: list[tuple[Register, Callable[[], float]]] = field(default_factory=list)
    host: str = "127.0.0.1"
    port: int = 0
    silent: bool = False
    rtu: bool = False

    def __post_init__(self) -> None:
        self.memory: dict[str, list[int]] = {t: [0] * SIZE for t in ("holding", "input", "coil", "discrete")}
        self.received: list[bytes] = []
        self.sent: list[bytes] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: _Server | None = None
        self._ready = threading.Event()
        self._error: Exception | None = None

    @property
    def address(self) -> tuple[str, int]:
        return self.host, self.port

    def start(self) -> FakeModbus:
        """Returns when it listens. Raises OSError if the port is taken."""
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="fake-modbus", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise OSError(f"fake Modbus server cannot listen on {self.host}:{self.port}: {self._error}")
        return self

    def stop(self) -> None:
        if self._loop is not None and self._server is not None and self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(self._server.end(), self._loop)
            self._thread.join(5)

    async def _serve(self) -> None:
        bits = SimData(0, values=[False] * SIZE, datatype=DataType.BITS)
        words = SimData(0, count=SIZE, values=0, datatype=DataType.REGISTERS)
        device = SimDevice(id=0, simdata=([bits], [bits], [words], [words]), action=self._action)
        try:
            self._loop = asyncio.get_running_loop()
            framer = FramerType.RTU if self.rtu else FramerType.SOCKET
            self._server = _Server(device, framer=framer, address=self.address, trace_packet=self._trace)
            await self._server.serve_forever(background=True)
            listener = cast(asyncio.Server, self._server.transport)  # of a server, whatever pymodbus declares
            self.port = listener.sockets[0].getsockname()[1]
        except Exception as error:
            self._error = error
            return
        finally:
            self._ready.set()
        with contextlib.suppress(asyncio.CancelledError):
            await self._server.serving

    def _trace(self, sending: bool, data: bytes) -> bytes:
        (self.sent if sending else self.received).append(bytes(data))
        return b"" if sending and self.silent else data

    async def _action(self, function: int, start: int, address: int, count: int, current: list, wanted: list | None) -> ExcCodes | None:
        """pymodbus' hook, before it answers: take what is written, put what is live."""
        table = _TABLE.get(function, "holding")
        memory = self.memory[table]
        if wanted:
            memory[address : address + len(wanted)] = [int(v) for v in wanted]
            self._written(table, address, len(wanted))
            return None
        self._refresh()
        if table in ("coil", "discrete"):
            first = address // 16
            for word in range(first, first + count):
                current[word - start] = sum(bit << k for k, bit in enumerate(memory[16 * word : 16 * word + 16]))
        else:
            current[address - start : address - start + count] = memory[address : address + count]
        return None

    def _written(self, table: str, address: int, count: int) -> None:
        p = self.positioner
        if p is None or p.position is None or p.position.table != table:
            return
        first, last = p.position.address, p.position.address + p.position.count
        if address < last and address + count > first:
            p.written(p.position.decode(self.memory[table][first:last]))

    def _refresh(self) -> None:
        live = [(register, value()) for register, value in self.values]
        if self.positioner is not None:
            live += self.positioner.outputs()
        for register, value in live:
            memory, at = self.memory[register.table], register.address
            if register.is_bit:
                memory[at] = int(bool(value))
            elif register.bit is not None:
                memory[at] = memory[at] & ~(1 << register.bit) | int(bool(value)) << register.bit
            else:
                memory[at : at + register.count] = register.encode(value)
