"""The stream into a .rrd file (and a live viewer). It watches the disk: a full disk ends the run with an error and never blocks it."""

from __future__ import annotations

import collections
import ctypes
import os
import shutil
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from mbcacq.errors import RecordingError
from mbcacq.files.atomic_write import inside_folder, sync_folder
from mbcacq.recording.rrd import layout, rerun_program
from mbcacq.recording.rrd.checksums import Stretch, digest_of_file, note_stretch
from mbcacq.recording.rrd.new_stream import new_stream, send_default_blueprint
from mbcacq.recording.rrd.rerun_path import rerun_path

STALLED_S = 5  # without one byte more in the file, while there is something to write
MARGIN_BYTES = 48 << 20
FIRST_BYTES = 1 << 20  # more than what a recording begins with: blueprint, plan, scene
TICK_S = 0.04


class Sink:
    """One recording file. ``stream`` is the rerun stream; it must not be used after ``close`` or a RecordingError."""

    def __init__(self, path: Path, recording_id: str, *, live: bool, port: int, blueprint: rrb.Blueprint) -> None:
        rerun_path(path)  # what is written could not be read
        inside_folder(path)
        _refuse_full_disk(path)
        self.path = path
        self._alive = True
        self._sync = _Syncer(path)
        self.live_url: str | None = None
        config = rr.ChunkBatcherConfig(flush_tick=TICK_S)
        rr.set_strict_mode(True)
        self.stream = new_stream(layout.APPLICATION, recording_id=recording_id, batcher_config=config)
        try:
            sinks: list = [rr.FileSink(path)]
            if live:
                server = rr.GrpcServerSink(bind_ip="127.0.0.1", port=rerun_program.free_port(port), server_memory_limit="512MB")
                self.live_url = server.uri
                sinks.append(server)
            self.stream.set_sinks(*sinks)
            send_default_blueprint(self.stream, blueprint)
        except (RuntimeError, ValueError, OSError) as error:
            raise RecordingError(f"the recording {path} cannot be opened: {error}; choose another folder (or live port)") from error
        sync_folder(path.parent)

    def check_space(self, size: int) -> None:
        """Raise RecordingError before ``size`` bytes would fill the disk."""
        free = shutil.disk_usage(self.path.parent).free
        if free < size + MARGIN_BYTES:
            self.stop_writing()
            raise RecordingError(
                f"the disk of {self.path.parent} is almost full ({free >> 20} MiB free); what was measured is kept: "
                "free some space and resume the run"
            )

    def check_predicted_size(self, done: int, poses: int) -> None:
        """Raise RecordingError if the poses to come will not fit, judged by the size of those done: early, when little is lost."""
        need = self.path.stat().st_size * max(poses - done, 0) // done
        free = shutil.disk_usage(self.path.parent).free
        if free < need:
            self.stop_writing()
            raise RecordingError(
                f"the run needs about {need >> 20} MiB more, {free >> 20} MiB are free in {self.path.parent}; "
                "free some space and resume the run"
            )

    def push(self) -> None:
        """Start writing everything logged to the file, without waiting."""
        if self._alive:
            try:
                self.stream.flush(timeout_sec=0)
            except RuntimeError as error:
                raise self._lost(error) from error

    def flush(self, finished: int | None = None) -> None:
        """Wait until everything logged is in the file, then let it be synced. finished: number of a pose that was finished just now.
        Raises RecordingError if it cannot be written."""
        if self._alive:
            try:
                self._wait()
            except RuntimeError as error:
                raise self._lost(error) from error
            self._sync.soon(finished)

    def _lost(self, error: RuntimeError) -> RecordingError:
        self.abandon()
        return RecordingError(
            f"the recording {self.path} can no longer be written ({error}); is the disk full? "
            f"What was written is kept: mbcacq recover {self.path}"
        )

    def _wait(self) -> None:
        """Flush for as long as the file still grows: a writer that met an error may leave a flush waiting for ever."""
        stalled, size = 0, -1
        while True:
            try:
                return self.stream.flush(timeout_sec=1.0)
            except RuntimeError:
                now = self.path.stat().st_size
                stalled, size = (stalled + 1, size) if now == size else (0, now)
                if stalled >= STALLED_S - 1:
                    raise

    def stop_writing(self) -> None:
        """Complete the file as it is; later calls do nothing."""
        if self._alive:
            self._alive = False
            try:
                self._wait()
                self.stream.disconnect()
            except RuntimeError:
                self.abandon()
            self._sync.close()

    def close(self) -> None:
        """Flush, write the footer, bring everything to the disk. Idempotent."""
        if self._alive:
            self.flush()
            self._alive = False
            self.stream.disconnect()
            self._sync.close()

    def abandon(self) -> None:
        """Let go of a stream whose file cannot be written. Disconnecting or freeing it may wait for ever, so neither is done."""
        self._alive = False
        rr.unregister_shutdown()
        for kept in (self.stream, self.stream.to_native()):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))


def _refuse_full_disk(path: Path) -> None:
    """Raises RecordingError if the disk takes not the first bytes: the library's writer ends at once there, and a stream that shall
    write to it waits for ever. Free space does not show it all: there are quotas and limits of a process."""
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            file.write(bytes(FIRST_BYTES))
    except OSError as error:
        raise RecordingError(f"the recording {path} cannot be written: {error.strerror}; free the disk or choose another folder") from error


class _Syncer:
    """Brings the file to the disk after every flush and notes the checksum of what came since, in a thread of its own, so that a power cut
    loses little and a scan never waits.

    ``os.fsync`` works on a handle that may be written, on POSIX and on Windows.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._wake, self._quit = path, threading.Event(), False
        self._finished: collections.deque[int] = collections.deque()
        self._noted = 0  # bytes whose checksum is noted
        self._thread = threading.Thread(target=self._work, name="recording-sync", daemon=True)
        self._thread.start()

    def soon(self, finished: int | None = None) -> None:
        if finished is not None:
            self._finished.append(finished)
        self._wake.set()

    def close(self) -> None:
        self._quit = True
        self._wake.set()
        self._thread.join(timeout=60.0)

    def _work(self) -> None:
        while not self._quit:
            self._wake.wait()
            self._wake.clear()
            self._bring_to_disk()
        self._bring_to_disk()  # what came while the last one was under way

    def _bring_to_disk(self) -> None:
        with suppress(OSError):  # the next flush reports a disk that does not take the data
            self._sync_and_note()

    def _sync_and_note(self) -> None:
        poses = tuple(self._finished.popleft() for _ in range(len(self._finished)))
        handle = os.open(self._path, os.O_RDWR)
        try:
            end = os.fstat(handle).st_size
            os.fsync(handle)
        finally:
            os.close(handle)
        if end > self._noted:
            digest, end = digest_of_file(self._path, self._noted, end)
            note_stretch(self._path.parent, Stretch(self._path.name, self._noted, end, digest, poses))
            self._noted = end
