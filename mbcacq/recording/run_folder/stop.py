"""A run that another process executes, ended as Ctrl-C ends it. No process is signalled that does not hold the lock of the run's folder."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from mbcacq.errors import ConfigError, SystemRefused
from mbcacq.recording.run_folder.lock import LockOwner, holds_lock, lock_owner


def stop_run(folder: Path | str) -> LockOwner:
    """Send the process that holds the lock of a folder what Ctrl-C sends: the arm comes to rest, the recording is completed.

    A process that was started deaf to Ctrl-C (in the background of a shell) gets SIGTERM, which ends a run in the same order.

    Returns
    -------
    LockOwner
        Who was signalled.

    Raises
    ------
    ConfigError
        If no process holds the lock: nothing runs in the folder.
    SystemRefused
        If the system cannot prove who holds it (only Linux can), the process is another user's, or it heeds neither signal.
    """
    owner = lock_owner(folder)
    if owner is None:
        raise ConfigError(f"nothing runs in {folder}; there is nothing to stop")
    if not hasattr(os, "pidfd_open"):
        raise SystemRefused(_by_hand(owner, "this system cannot prove that it is the run of this folder"))
    try:
        handle = os.pidfd_open(owner.pid)  # from here on it means this process, whoever gets its number later
    except ProcessLookupError:
        raise ConfigError(f"nothing runs in {folder} any more; process {owner.pid} has ended") from None
    except OSError as error:
        raise SystemRefused(_by_hand(owner, f"the system does not let us name it: {error.strerror}")) from error
    try:
        held = holds_lock(owner.pid, folder)
        if held is None:
            raise SystemRefused(_by_hand(owner, "it is another user's process"))
        if not held:
            raise ConfigError(f"nothing runs in {folder} any more; process {owner.pid} is another program")
        number = _heeded(owner.pid)
        if number is None:
            raise SystemRefused(_by_hand(owner, "it heeds neither Ctrl-C nor a request to end"))
        signal.pidfd_send_signal(handle, number)
    except ProcessLookupError:
        raise ConfigError(f"nothing runs in {folder} any more; process {owner.pid} has just ended") from None
    except PermissionError:
        raise SystemRefused(_by_hand(owner, "it is another user's process")) from None
    finally:
        os.close(handle)
    return owner


def _heeded(pid: int) -> signal.Signals | None:
    """The signal that a process ends in order at, SIGINT first; None if it has a handler of neither: it would break off."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace").splitlines()
        caught = next(int(line.split()[1], 16) for line in lines if line.startswith("SigCgt:"))
    except (OSError, ValueError, IndexError, StopIteration):
        return None
    return next((number for number in (signal.SIGINT, signal.SIGTERM) if caught >> (number - 1) & 1), None)


def _by_hand(owner: LockOwner, why: str) -> str:
    return f"process {owner.pid} (mbcacq {owner.command}) was not signalled: {why}; end it by Ctrl-C in its own terminal"
