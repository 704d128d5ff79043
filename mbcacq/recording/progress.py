"""What of a run is already measured, so that a resumed run can skip it."""

from __future__ import annotations

from pathlib import Path

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording import layout
from mbcacq.recording.journal import read_journal


def poses_done(folder: Path | str) -> frozenset[int]:
    """Numbers of the poses that the journal of a run folder lists and its recordings hold.

    After a power cut the journal can be ahead of the recording; such a pose is measured again. Raises RecordingError if there is
    no journal or a recording is torn (``mbcacq recover`` makes it readable).
    """
    from mbcacq.recording.reader import open_recordings

    folder = Path(folder)
    listed = {int(entry["pose"]) for entry in read_journal(folder) if entry.get("event") == "pose_done"}
    try:
        recordings = open_recordings(folder) if layout.parts(folder) else []
    except ConfigError as error:
        raise RecordingError(str(error)) from None
    return frozenset(listed & {int(row["pose"][0]) for recording in recordings for row in recording.observed()})
