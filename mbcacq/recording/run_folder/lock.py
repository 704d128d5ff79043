"""One writer at a time in a run folder. The lock is the operating system's: it ends with its process, so a killed one leaves none."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from mbcacq.errors import RecordingError

LOCK_FILE, OWNER_FILE = ".run.lock", ".run.lock.json"
READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)


@contextmanager
def write_lock(folder: Path | str, command: str) -> Iterator[None]:
    """Hold the lock of a folder, which exists, for a command: 'run', 'recover', 'report'. Not reentrant.

    Raises RecordingError with the pid of the process that holds it. A folder that cannot be written to needs no lock.
    """
    folder = Path(folder)
    lock = FileLock(folder / LOCK_FILE)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise RecordingError(f"{folder} is in use by {_owner(folder)}; wait until it ends, or end it") from None
    except OSError as error:
        if error.errno not in READ_ONLY:
            raise RecordingError(f"{folder} cannot be locked: {error.strerror}; choose a folder on another disk") from error
        yield
        return
    try:
        with suppress(OSError):  # a full disk: the lock holds, only its owner's name is missing
            (folder / OWNER_FILE).write_text(json.dumps({"pid": os.getpid(), "command": command}), encoding="utf-8")
        yield
    finally:
        with suppress(OSError):
            (folder / OWNER_FILE).unlink()
        lock.release()


def _owner(folder: Path) -> str:
    try:
        owner = json.loads((folder / OWNER_FILE).read_text(encoding="utf-8"))
        return f"process {int(owner['pid'])} (mbcacq {owner['command']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
