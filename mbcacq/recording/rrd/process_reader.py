"""A recording read by the rerun library in a process of its own, whose end harms nobody: for files that may be damaged."""

from __future__ import annotations

import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pyarrow as pa

from mbcacq.devices import ChildEnded, ChildProcess
from mbcacq.errors import RecordingError
from mbcacq.recording.rrd.reading_child import BATCH, ERROR


class ProcessReader:
    """As ``LibraryReader``. Raises RecordingError, also where the library ended its process."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._idle: list[_ReadingProcess] = [_ReadingProcess(path)]
        self.recording_id = self._idle[0].recording_id

    def stream(self, entities: str) -> Iterator[pa.RecordBatch]:
        process = self._idle.pop() if self._idle else _ReadingProcess(self.path)
        yield from process.batches(entities)
        self._idle.append(process)  # one that was not asked to the end, or that failed, ends where nobody holds it


class _ReadingProcess:
    def __init__(self, path: Path) -> None:
        self._path = path
        paths = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        self._child = ChildProcess(
            *("-P", "-m", "mbcacq.recording.rrd.reading_child", str(path)),
            dump=lambda entities, pipe: pipe.write(entities.encode() + b"\n"),
            load=_frame,
            stderr=subprocess.DEVNULL,  # where the library writes why it gives up
            env={**os.environ, "PYTHONPATH": paths},
        )
        weakref.finalize(self, self._child.end, 0.0)
        self.recording_id = self._answer()[1].decode()

    def batches(self, entities: str) -> Iterator[pa.RecordBatch]:
        try:
            self._child.send(entities)
        except ChildEnded:
            raise self._ended() from None
        while (frame := self._answer())[0] == BATCH:
            with pa.ipc.open_stream(frame[1]) as stream:
                yield from stream

    def _answer(self) -> tuple[bytes, bytes]:
        try:
            kind, data = self._child.receive()
        except ChildEnded:
            raise self._ended() from None
        if kind == ERROR:
            raise RecordingError(data.decode())
        return kind, data

    def _ended(self) -> RecordingError:
        return RecordingError(
            f"{self._path} is damaged: the library that reads recordings gave up at it; "
            f"mbcacq recover --check says where, mbcacq recover {self._path} makes the rest of it readable"
        )


def _frame(pipe: IO[bytes]) -> tuple[bytes, bytes]:
    head = pipe.read(9)
    data = pipe.read(int.from_bytes(head[1:], "little")) if len(head) == 9 else b""
    if len(head) < 9 or len(data) < int.from_bytes(head[1:], "little"):
        raise EOFError
    return head[:1], data
