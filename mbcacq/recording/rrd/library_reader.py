"""A recording read by the rerun library in this process, as Arrow batches. A footer is not needed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa

from mbcacq.errors import MbcacqError, RecordingError
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checksums import FILE as CHECKSUMS
from mbcacq.recording.rrd.rerun_path import rerun_path

MAGIC = b"RRF"  # first bytes of every .rrd file
NOT_OURS = "holds no recording of mbcacq"  # in the sentence about a file that can be read, and was written by another program


class LibraryReader:
    """One .rrd file. A file without its footer is read from end to end.

    The library ends the whole process at some damaged files (it aborts in its Arrow buffers). Only a file that is known to be undamaged may
    be read in a process that must live on. Raises RecordingError.

    It calls what ``rerun.chunk.RrdReader`` calls: importing that imports all of rerun, which takes longer than reading a run.
    """

    def __init__(self, path: Path) -> None:
        from rerun_bindings import RrdReaderInternal

        self.path = path
        with _named_errors(path):
            self._reader = RrdReaderInternal(rerun_path(path))
            recordings = [store for store in self._reader.store_entries() if store.kind == "recording"]
            stores = [store for store in recordings if store.application_id == layout.APPLICATION]
        if not stores:
            raise RecordingError(f"{path} {NOT_OURS}: it was torn before anything was written, or another program wrote it")
        self._store = stores[0]
        try:
            self._indexed = self._reader.store(store=self._store)
        except (RuntimeError, ValueError):
            self._indexed = None  # no footer: the run was cut short

    @property
    def recording_id(self) -> str:
        return self._store.recording_id

    def stream(self, entities: str) -> Iterator[pa.RecordBatch]:
        """The batches of an entity, or of all below one ('health/**')."""
        chunks = iter(())
        with _named_errors(self.path):
            stream = self._indexed.stream() if self._indexed is not None else self._reader.stream(store=self._store)
            chunks = iter(stream.filter(content=[f"/{entities}"]))
        while True:
            with _named_errors(self.path):
                chunk = next(chunks, None)
                batch = None if chunk is None else chunk.to_record_batch()
            if batch is None:
                return
            yield batch


def _begins_as_recording(path: Path) -> bool:
    """Whether a file begins as a recording, or lies where one was written and was damaged since."""
    try:
        with path.open("rb") as file:
            return file.read(3) == MAGIC or (path.parent / CHECKSUMS).exists()
    except OSError:
        return True


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    """Turns what the rerun library raises into one sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a file without footer is read as well as one with
            yield
    except MbcacqError:
        raise
    except (RuntimeError, ValueError, OSError, pa.ArrowException) as error:
        if not _begins_as_recording(path):
            raise RecordingError(f"{path} is no recording: it does not begin as a .rrd file does; give another file") from None
        raise RecordingError(
            f"{path} is torn or is no .rrd file ({(str(error).splitlines() or [type(error).__name__])[0]}); "
            f"make what is left of it readable: mbcacq recover {path}"
        ) from None
