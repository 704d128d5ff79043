"""A recording read by the rerun library in a process of its own, whose end harms nobody: for files that may be damaged.

The process takes entities, a line each, and answers with frames: a letter, the length (8 bytes, little-endian) and that many bytes. ``R``:
ready, with the recording id; ``B``: a batch as an Arrow stream; ``E``: a sentence on what is wrong; ``.``: no more batches.
"""

from __future__ import annotations

import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

import pyarrow as pa

from mbcacq.devices import ChildEnded, ChildProcess
from mbcacq.errors import RecordingError
from mbcacq.recording.rrd.library_reader import LibraryReader

READY, BATCH, ERROR, END = b"R", b"B", b"E", b"."


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
            *("-P", "-m", "mbcacq.recording.rrd.process_reader", str(path)),
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


def main() -> None:
    """The process itself."""
    with suppress(ImportError):  # Windows writes no memory to the disk
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(os.dup(1), "wb") as answers, suppress(BrokenPipeError):
        os.dup2(2, 1)  # what the library prints is no answer
        try:
            reader = LibraryReader(Path(sys.argv[1]))
            _answer(answers, READY, reader.recording_id.encode())
            for line in sys.stdin.buffer:
                for batch in reader.stream(line.decode().strip()):
                    _answer(answers, BATCH, _checked(batch))
                _answer(answers, END, b"")
        except RecordingError as error:
            _answer(answers, ERROR, str(error).encode(errors="replace"))
        except pa.ArrowException as error:
            reason = str(error).splitlines()[0]
            _answer(answers, ERROR, f"{sys.argv[1]} is damaged ({reason}); mbcacq recover --check says where".encode(errors="replace"))


def _checked(batch: pa.RecordBatch) -> pa.Buffer:
    """Serialised, where its offsets and lengths are within its buffers: the other side believes them."""
    batch.validate(full=True)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as stream:
        stream.write_batch(batch)
    return sink.getvalue()


def _answer(answers: IO[bytes], kind: bytes, data: bytes | pa.Buffer) -> None:
    answers.write(kind + len(data).to_bytes(8, "little"))
    answers.write(data)
    answers.flush()


if __name__ == "__main__":
    main()
