"""Memory shared by the driver and its cycle process: commands one way, raw cycles and the fault the other. No locks on either side.

Layout: int64 header | two command slots | names (JSON) | fault (JSON) | ring of rows of doubles. Only plain stores are used, each
followed by the counter that makes it visible.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import shared_memory
from typing import Any

from mbcacq_kuka.rsi.sequence import Counts
from mbcacq_kuka.shared_block import SharedBlock, allocated, attached

MOVE, STOP, CLOSE = 1, 2, 3
MOVING, ARRIVED, ANSWERED = 1, 2, 4
ALL_OUTPUTS = -1  # every bit
COUNTED = ("lost", "repeated", "old", "foreign")  # see sequence.Counts
FIXED = ("host_time_s", "time_s", "flags", "command", *COUNTED, "cA1", "cA2", "cA3", "cA4", "cA5", "cA6")

_COMMAND_SEQ, _HEAD, _WIDTH, _CAPACITY, _FAULT_SIZE, _NAMES_SIZE, _HEARD, _SENDER, _DISCARDED, _DECIMALS, _OUTPUTS = range(11)
_COMMAND = struct.Struct("<27d")
_COMMAND_AT = (128, 512)
_NAMES_AT, _FAULT_AT, _RING_AT = 1024, 24576, 32768
_MAX_FAULT = _RING_AT - _FAULT_AT
_MAX_NAMES = _FAULT_AT - _NAMES_AT
RING_BYTES = 16 * 1024 * 1024


@dataclass(frozen=True)
class RsiCommand:
    """kind: MOVE, STOP or CLOSE. target, speed, acceleration, jerk: (6,) deg, deg/s...; tolerance deg; settle_s on the robot's clock."""

    kind: int
    target: Sequence[float] = (0.0,) * 6
    speed: Sequence[float] = (0.0,) * 6
    acceleration: Sequence[float] = (0.0,) * 6
    jerk: Sequence[float] = (0.0,) * 6
    tolerance: float = 0.0
    settle_s: float = 0.0


class Shared(SharedBlock):
    """One session's block. The driver creates it, the cycle process attaches."""

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool) -> None:
        super().__init__(memory, owner)
        self._header = self._buffer[:128].cast("q")

    @classmethod
    def create(cls) -> Shared:
        """Raises OSError where the memory is not there."""
        return cls(allocated(_RING_AT + RING_BYTES), True)

    @classmethod
    def attach(cls, name: str) -> Shared:
        return cls(attached(name), False)

    def close(self) -> None:
        self._header.release()
        super().close()

    # commands: one writer at a time (the driver holds a lock), one reader

    @property
    def command_seq(self) -> int:
        return self._header[_COMMAND_SEQ]

    def send(self, command: RsiCommand) -> int:
        """Publish a command; its number comes back in the ``command`` column of the cycles that follow it."""
        seq = self._header[_COMMAND_SEQ] + 1
        _COMMAND.pack_into(
            self._buffer,
            _COMMAND_AT[seq & 1],
            command.kind,
            *command.target,
            *command.speed,
            *command.acceleration,
            *command.jerk,
            command.tolerance,
            command.settle_s,
        )
        self._header[_COMMAND_SEQ] = seq
        return seq

    def receive(self) -> tuple[int, RsiCommand]:
        while True:
            seq = self._header[_COMMAND_SEQ]
            v = _COMMAND.unpack_from(self._buffer, _COMMAND_AT[seq & 1])
            if self._header[_COMMAND_SEQ] == seq:
                return seq, RsiCommand(int(v[0]), v[1:7], v[7:13], v[13:19], v[19:25], v[25], v[26])

    # digital outputs, apart from the commands, of which only the last one counts

    @property
    def outputs(self) -> int:
        """Which are to be on: bit k is the k-th of the option digital_outputs."""
        return self._header[_OUTPUTS]

    @outputs.setter
    def outputs(self, value: int) -> None:
        self._header[_OUTPUTS] = value

    # cycles: rows of doubles, FIXED and then the session's values

    def begin(self, names: Sequence[str]) -> None:
        """Lay out the ring for a session that sends ``names``; until then there are no rows."""
        text = json.dumps(list(names)).encode()
        if len(text) > _MAX_NAMES:
            raise ValueError("the names of the telegram's elements are too long")
        self._buffer[_NAMES_AT : _NAMES_AT + len(text)] = text
        width = len(FIXED) + len(names)
        self._row = struct.Struct(f"<{width}d")
        self._header[_NAMES_SIZE], self._header[_WIDTH] = len(text), width
        self._header[_CAPACITY] = self._capacity = RING_BYTES // self._row.size

    def append(
        self, host_time_s: float, time_s: float, flags: int, command: int, counts: Counts, degrees: Sequence[float], values: Sequence[float]
    ) -> None:
        """One cycle; ``command``: number of the command that ``degrees``, the set point answered, belongs to."""
        head = self._header[_HEAD]
        place = _RING_AT + head % self._capacity * self._row.size
        counted = (counts.lost, counts.repeated, counts.old, counts.foreign)
        self._row.pack_into(self._buffer, place, host_time_s, time_s, flags, command, *counted, *degrees, *values)
        self._header[_HEAD] = head + 1

    @property
    def head(self) -> int:
        """How many rows were ever written."""
        return self._header[_HEAD]

    @property
    def width(self) -> int:
        return self._header[_WIDTH]

    @property
    def capacity(self) -> int:
        return self._header[_CAPACITY]

    @property
    def ring(self) -> memoryview:
        return self._buffer[_RING_AT : _RING_AT + self.capacity * self.width * 8]

    def names(self) -> list[str]:
        return json.loads(bytes(self._buffer[_NAMES_AT : _NAMES_AT + self._header[_NAMES_SIZE]]))

    # what a session that has not begun yet has heard

    def note(self, heard: int, source: Any, discarded: float) -> None:
        """How many datagrams came, the address (IPv4, port) of the last, by how much the controller's Delay has risen."""
        self._header[_SENDER] = int.from_bytes(socket.inet_aton(source[0]), "big") << 16 | source[1]
        self._header[_DISCARDED], self._header[_HEARD] = int(discarded), heard

    def noted(self) -> tuple[int, str, int]:
        """As given to ``note``, the address as text."""
        sender = self._header[_SENDER]
        address = f"{socket.inet_ntoa((sender >> 16).to_bytes(4, 'big'))}:{sender & 0xFFFF}"
        return self._header[_HEARD], address, self._header[_DISCARDED]

    @property
    def decimals(self) -> int:
        """With how many decimals the controller writes joint angles."""
        return self._header[_DECIMALS]

    @decimals.setter
    def decimals(self, value: int) -> None:
        self._header[_DECIMALS] = value

    # the first fault of a session

    def fail(self, kind: str, text: str) -> None:
        if self._header[_FAULT_SIZE] == 0:
            raw = json.dumps({"kind": kind, "text": text}).encode()[:_MAX_FAULT]
            self._buffer[_FAULT_AT : _FAULT_AT + len(raw)] = raw
            self._header[_FAULT_SIZE] = len(raw)

    def fault(self) -> dict[str, Any] | None:
        size = self._header[_FAULT_SIZE]
        return json.loads(bytes(self._buffer[_FAULT_AT : _FAULT_AT + size])) if size else None
