"""Whether this process may use as much memory as a run needs: asked before motion, since libraries end a process that gets none."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress

from mbcacq.errors import SystemRefused

RUN_BYTES = 1280 << 20  # a dry run of plans/quick.yaml on two cores comes to 1.11e9 bytes of addresses, with little reserved
_ARENA_MAX = -8  # M_ARENA_MAX of glibc's malloc.h


def refuse_small_address_space() -> None:
    """Make do with few addresses where a limit is set on them (ulimit -v). Raises SystemRefused if a run needs more than the limit."""
    if sys.platform == "win32":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return
    if limit < RUN_BYTES:
        raise SystemRefused(
            f"a process may use {limit >> 20} MiB of addresses here, and a run needs {RUN_BYTES >> 20} MiB; raise the limit (ulimit -v)"
        )
    _reserve_little()


def _reserve_little() -> None:
    """glibc reserves 64 MiB of addresses for each thread that allocates, of which nearly all stay empty, and what comes after them gets
    none. Here and in processes to come.
    """
    os.environ.setdefault("MALLOC_ARENA_MAX", "1")
    with suppress(AttributeError, OSError):  # another C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)
