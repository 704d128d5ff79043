"""Shared memory between a fake controller's process and whoever runs it: faults in, counters and a log of the cycles out."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from multiprocessing import shared_memory

from mbcacq_kuka.shared_block import SharedBlock, attached

from mbcacq_fakes.protocols.krc.arm_state import create_shared_memory
from mbcacq_fakes.protocols.krc.settings import FAULTS

COUNTERS = ("cycles", "sessions", "answers", "late", "rejected", "active", "ended")
LOG_COLUMNS = ("ipoc", "latency_s", "accepted", "q1", "q2", "q3", "q4", "q5", "q6", "c1", "c2", "c3", "c4", "c5", "c6")

_FAULTS_AT, _COUNTERS_AT, _HEAD_AT, _LED_AT, _LOG_AT = 8, 256, 384, 448, 512
_ROW = struct.Struct(f"<{len(LOG_COLUMNS)}d")
_LOG_ROWS = 1 << 17


class Control(SharedBlock):
    """``log``: keep the last 131072 cycles (15 MB)."""

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool) -> None:
        super().__init__(memory, owner)
        self._double = self._buffer.cast("d")
        self._int = self._buffer.cast("q")
        self.log_rows = (memory.size - _LOG_AT) // _ROW.size

    @classmethod
    def create(cls, log: bool) -> Control:
        return cls(create_shared_memory(4096 + (_LOG_ROWS * _ROW.size if log else 0)), True)

    @classmethod
    def attach(cls, name: str) -> Control:
        return cls(attached(name), False)

    def close(self) -> None:
        self._double.release()
        self._int.release()
        super().close()

    def set_faults(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            self._double[_FAULTS_AT // 8 + FAULTS.index(name)] = float(value)
        self._int[0] += 1

    def lead(self, target_deg: Sequence[float]) -> None:
        """Another program on the controller moves the arm to ``target_deg`` (6,)."""
        first = _LED_AT // 8
        for k, angle in enumerate(target_deg, 1):
            self._double[first + k] = float(angle)
        self._int[first] += 1

    @property
    def led_seq(self) -> int:
        """How often the arm was led so far."""
        return self._int[_LED_AT // 8]

    def led(self) -> tuple[float, ...]:
        """Where it was led to at last, (6,) deg."""
        first = _LED_AT // 8
        return tuple(self._double[first + 1 : first + 7])

    @property
    def fault_seq(self) -> int:
        return self._int[0]

    def faults(self) -> dict[str, float]:
        first = _FAULTS_AT // 8
        return dict(zip(FAULTS, self._double[first : first + len(FAULTS)], strict=True))

    def count(self, name: str, value: int) -> None:
        self._int[_COUNTERS_AT // 8 + COUNTERS.index(name)] = value

    def counters(self) -> dict[str, int]:
        first = _COUNTERS_AT // 8
        return dict(zip(COUNTERS, self._int[first : first + len(COUNTERS)], strict=True))

    def log(self, *row: float) -> None:
        head = self._int[_HEAD_AT // 8]
        _ROW.pack_into(self._buffer, _LOG_AT + head % self.log_rows * _ROW.size, *row)
        self._int[_HEAD_AT // 8] = head + 1

    def read_log(self) -> list[tuple[float, ...]]:
        head, rows = self._int[_HEAD_AT // 8], self.log_rows
        return [_ROW.unpack_from(self._buffer, _LOG_AT + i % rows * _ROW.size) for i in range(max(0, head - rows), head)]
