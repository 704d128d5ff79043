"""Signals that wait until what is being made is whole."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows lacks some


@contextmanager
def signals_deferred() -> Iterator[None]:
    """The first of Ctrl-C, SIGTERM and SIGHUP that comes in the block is acted on at its end.

    It protects things that are made in a moment and would be left behind by an interruption, such as a block of shared memory that nobody
    holds yet. Without effect in other threads than the main one, where no handler runs, and on signals that are ignored or end the process.
    """
    came: list[int] = []
    before = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in (getattr(signal, name) for name in NAMES if hasattr(signal, name)):
                if callable(handler := signal.getsignal(number)):
                    before[number] = handler
                    signal.signal(number, lambda number, frame: came.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
