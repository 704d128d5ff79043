"""The process in which the rerun library reads a recording that may be damaged. It imports little, for whoever reads waits for it.

The process takes entities, a line each, and answers with frames: a letter, the length (8 bytes, little-endian) and that many bytes. ``R``:
ready, with the recording id; ``B``: a batch as an Arrow stream; ``E``: a sentence on what is wrong; ``.``: no more batches.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO

import pyarrow as pa

from mbcacq.errors import RecordingError
from mbcacq.recording.rrd.library_reader import LibraryReader

READY, BATCH, ERROR, END = b"R", b"B", b"E", b"."


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
