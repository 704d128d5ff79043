"""Streams of the rerun library, made so that a program may make many."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings

from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.rerun_path import rerun_path


def new_stream(application: str, recording_id: str | None = None, **options: Any) -> rr.RecordingStream:
    """A stream that belongs to the caller alone; ``options`` as of ``rerun.RecordingStream``.

    The library keeps two threads for every stream until the program ends, also where nobody holds the stream any more; those that were
    closed before are freed here.
    """
    rerun_bindings.flush_and_cleanup_orphaned_recordings()
    return rr.RecordingStream(application, recording_id=recording_id, **options)


@contextmanager
def into_file(stream: rr.RecordingStream, path: Path) -> Iterator[None]:
    """Everything logged in the block is in the file at its end, and the stream is closed.

    It is kept in memory until then: the library's own writer waits for ever where the disk takes not even the first bytes of a file.
    Raises OSError where the file cannot be written, ConfigError where its name cannot be read by the library.
    """
    rerun_path(path)
    memory = stream.memory_recording()
    try:
        yield
        path.write_bytes(memory.drain_as_bytes())
    finally:
        stream.disconnect()


@contextmanager
def filed(
    path: Path, blueprint: rrb.Blueprint | None = None, application: str = layout.APPLICATION, **options: Any
) -> Iterator[rr.RecordingStream]:
    """A stream of its own, whose rows are the file when the block ends. blueprint: what a viewer shows at first; options: as of
    ``new_stream``. Raises OSError where the file cannot be written, which ``replacing`` and ``write_files`` make a sentence of."""
    stream = new_stream(application, **options)
    try:
        with into_file(stream, path):
            if blueprint is not None:
                send_default_blueprint(stream, blueprint)
            yield stream
    except RuntimeError as error:  # of the rerun library
        raise OSError(str(error)) from error


def send_default_blueprint(stream: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """Write ``blueprint`` into ``stream`` as what a viewer shows at first. The stream must have its sinks already.

    As ``RecordingStream.send_blueprint``, which holds the blueprint in a stream of its own whose memory refers back to that stream: the
    two keep each other, and two threads, until the program ends. Disconnecting that stream ends the circle.
    """
    application = stream.get_application_id()
    assert application is not None  # every stream of new_stream has one
    native = rerun_bindings.new_blueprint(application_id=application, make_default=False, make_thread_default=False, default_enabled=True)
    inner = rr.RecordingStream._from_native(native)
    inner.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(inner)
    try:
        rerun_bindings.send_blueprint(inner.memory_recording().storage, False, True, recording=stream.to_native())
    finally:
        inner.disconnect()
