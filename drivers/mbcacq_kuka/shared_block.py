"""A named block of memory that several processes see. It imports nothing that a process with a deadline of 4 ms would have to load."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from multiprocessing import resource_tracker, shared_memory
from pathlib import Path

FILES = Path("/dev/shm")  # where Linux has shared memory as files


class SharedBlock:
    """One process creates the block (``allocated``), any number attach (``attached``). Its name goes away with the process that made it."""

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool) -> None:
        assert memory.buf is not None  # it is None only once the memory is closed
        self._memory, self._buffer, self._owner, self.name = memory, memory.buf, owner, memory.name

    def forget(self) -> None:
        """Take the block's name away once everybody has attached: it then ends with them, whatever kills them."""
        if self._owner:
            self._owner = False
            self._memory.unlink()

    def close(self) -> None:
        """Idempotent; the creator also removes the block."""
        self._memory.close()
        self.forget()


class _Block(shared_memory.SharedMemory):
    """Where views of it are left, as in a program that was interrupted while it ended, it goes with the process: that is no error."""

    def close(self) -> None:
        with suppress(BufferError):
            super().close()


def allocated(size: int, name: str | None = None) -> shared_memory.SharedMemory:
    """A new block whose memory is there. At creation Linux only reserves it, and a write where none is left ends the process by SIGBUS.
    Other systems allocate at creation. Raises OSError."""
    memory = _Block(name=name, create=True, size=size)
    file = FILES / memory.name.lstrip("/")
    try:
        if file.exists():
            with file.open("r+b") as block:
                os.posix_fallocate(block.fileno(), 0, size)
    except OSError:
        memory.close()
        memory.unlink()
        raise
    return memory


def attached(name: str) -> shared_memory.SharedMemory:
    """A block of another process, which removes it. Raises FileNotFoundError."""
    if sys.version_info >= (3, 13):
        return _Block(name=name, track=False)
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None  # Python < 3.13 would remove the block when this process ends
    try:
        return _Block(name=name)
    finally:
        resource_tracker.register = register
