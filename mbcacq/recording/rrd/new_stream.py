"""Streams of the rerun library, made so that a program may make many."""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun_bindings


def new_stream(application: str, recording_id: str | None = None, **options: Any) -> rr.RecordingStream:
    """A stream that belongs to the caller alone; ``options`` as of ``rerun.RecordingStream``.

    The library keeps two threads for every stream until the program ends, also where nobody holds the stream any more; those that were
    closed before are freed here.
    """
    rerun_bindings.flush_and_cleanup_orphaned_recordings()
    return rr.RecordingStream(application, recording_id=recording_id, **options)
