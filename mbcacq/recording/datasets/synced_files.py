"""Files that are on the disk when the call returns, after a power cut too: the file first, then the folder that names it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from mbcacq.errors import RecordingError


def write_synced(path: Path, data: bytes) -> None:
    """Write a whole file; an existing one is replaced only when the new one is complete. Raises RecordingError."""
    partial = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise RecordingError(f"{path} cannot be written: {error.strerror}; choose another folder or free the disk") from error
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk. Windows does so by itself and has no handle of a folder to ask with; where the system
    refuses, the names come a little later."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
