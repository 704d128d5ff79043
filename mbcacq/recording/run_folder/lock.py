"""One writer at a time in a run folder. The lock is the operating system's: it ends with its process, so a killed one leaves none."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from mbcacq.errors import RecordingError
from mbcacq.files.atomic_write import inside_folder

LOCK_FILE, OWNER_FILE = ".run.lock", ".run.lock.json"
MOST_BYTES = 4096  # of the name of an owner
READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)


@contextmanager
def write_lock(folder: Path | str, command: str) -> Iterator[None]:
    """Hold the lock of a folder, which exists, for a command: 'run', 'recover', 'report'. Not reentrant.

    Raises RecordingError with the pid of the process that holds it. A folder that cannot be written to needs no lock.
    """
    folder = Path(folder)
    lock, owner = FileLock(inside_folder(folder / LOCK_FILE)), inside_folder(folder / OWNER_FILE)
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
            owner.unlink(missing_ok=True)  # of a process that was killed, or with a further name
            owner.write_text(json.dumps({"pid": os.getpid(), "command": command}), encoding="utf-8")
        yield
    finally:
        with suppress(OSError):
            owner.unlink()
        lock.release()


def _owner(folder: Path) -> str:
    owner = lock_owner(folder)
    return "another process" if owner is None else f"process {owner.pid} (mbcacq {owner.command})"


@dataclass(frozen=True)
class LockOwner:
    """Process that wrote its name beside the lock of a folder, and its command: 'run', 'run --resume', 'report'. A killed process leaves
    its name behind: whether it still holds the lock, ``holds_lock`` says."""

    pid: int
    command: str


def lock_owner(folder: Path | str) -> LockOwner | None:
    """Whose name stands beside the lock of a folder; None if nobody's does."""
    try:
        with (Path(folder) / OWNER_FILE).open("rb") as file:
            owner = json.loads(file.read(MOST_BYTES))
        found = LockOwner(int(owner["pid"]), str(owner["command"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None
    return found if 0 < found.pid < 1 << 31 else None


def holds_lock(pid: int, folder: Path | str) -> bool | None:
    """Whether a process holds the lock of a folder, by what the Linux kernel says of its open files; the lock itself is not touched.

    None if that cannot be known: on another system, or of another user's process.
    """
    process = Path("/proc") / str(pid)
    if not Path("/proc/self/fdinfo").is_dir():
        return None
    try:
        lock = (Path(folder) / LOCK_FILE).stat()
        numbers = [entry.name for entry in (process / "fd").iterdir()]
    except PermissionError:
        return None
    except OSError:
        return False
    return any(_is_locked(process, number, lock) for number in numbers)


def _is_locked(process: Path, number: str, lock: os.stat_result) -> bool:
    """Whether an open file of a process is the lock file, and locked by it."""
    try:
        if not os.path.samestat((process / "fd" / number).stat(), lock):
            return False
        lines = (process / "fdinfo" / number).read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:  # closed meanwhile
        return False
    return any(line.startswith("lock:") and "WRITE" in line for line in lines)
