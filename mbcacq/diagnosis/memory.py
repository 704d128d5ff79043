"""Memory that arrays gave back stays with the process for the next ones."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Numbers of mallopt of the GNU C library, and their values beforehand (malloc.h).
TRIM_THRESHOLD, MMAP_MAX = -1, -4
USUAL = {TRIM_THRESHOLD: 128 * 1024, MMAP_MAX: 65536}
KEPT = {TRIM_THRESHOLD: 2**31 - 1, MMAP_MAX: 0}


def keep_freed_memory() -> None:
    """For the rest of the process."""
    _set(KEPT)


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """For as long as the context lasts; afterwards the system gets back what is free.

    An array of more than 32 MiB is otherwise asked from the system anew each time and emptied by it page by page. In a diagnosis of 12,000
    poses that was a seventh of the time. Only the GNU C library can be set so; elsewhere nothing happens.
    """
    _set(KEPT)
    try:
        yield
    finally:
        _set(USUAL)
        if (library := _library()) is not None:
            library.malloc_trim(0)


def _set(values: dict[int, int]) -> None:
    if (library := _library()) is not None:
        for number, value in values.items():
            library.mallopt(number, value)


def _library() -> ctypes.CDLL | None:
    """The C library, where it is the GNU one."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") else None
