"""What the operating system can do for a process with a deadline: priority, memory, processor core. POSIX; elsewhere nothing is done."""

from __future__ import annotations

import ctypes
import gc
import os
import socket
import struct
from contextlib import suppress

_PRIORITY = 50
_PRESENT, _FUTURE = 1, 2  # MCL_CURRENT, MCL_FUTURE of sys/mman.h


def become_real_time(cpu: int | None) -> bool:
    """A fixed high priority, memory that is never paged out, a processor core of its own where ``cpu`` names one, no cycle collection of
    the interpreter. Each is left out where it is not permitted; returns whether the priority was.

    Without ``cpu`` the process stays free to leave a core that the kernel holds: fixed to one it missed more cycles
    (benchmarks/rsi_latency.md)."""
    gc.collect()
    gc.freeze()
    gc.disable()
    _lock_memory()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, OSError):
        return False
    if cpu is not None:
        _pin(cpu)
    return True


def end_real_time() -> None:
    """Cycles of objects are collected again: those of a session are freed before the interpreter ends, not leaked."""
    gc.unfreeze()
    gc.enable()


def _lock_memory() -> bool:
    """Future memory, too, but only where there is no limit: beyond a limit an allocation would fail."""
    try:
        import resource  # POSIX only

        unlimited = os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
        return ctypes.CDLL(None).mlockall(_PRESENT | _FUTURE if unlimited else _PRESENT) == 0
    except (AttributeError, ImportError, OSError, TypeError):
        return False


def _pin(cpu: int) -> None:
    """Only with priority: without it, a core of its own would be one that it must share with whatever else runs there."""
    with suppress(AttributeError, OSError):
        os.sched_setaffinity(0, {cpu})


def open_socket(address: str, port: int, wait_s: float) -> socket.socket:
    """Bound exclusively: a second program on the port would silently take the controller's telegrams. ``recvfrom`` waits ``wait_s`` at most
    and then raises TimeoutError or BlockingIOError. Raises OSError, OverflowError."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if (exclusive := getattr(socket, "SO_EXCLUSIVEADDRUSE", None)) is not None:  # Windows
            sock.setsockopt(socket.SOL_SOCKET, exclusive, 1)
        sock.bind((address, port))
        wait(sock, wait_s)
    except (OSError, OverflowError):
        sock.close()
        raise
    return sock


def wait(sock: socket.socket, wait_s: float) -> None:
    """Let the operating system keep the time where it can: a time-out of Python's own costs a second system call a telegram."""
    if os.name == "posix":
        sock.setblocking(True)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, round(wait_s * 1e6)))
    else:
        sock.settimeout(wait_s)
