"""A line that a person types at the terminal, waited for so that a stop ends the wait."""

from __future__ import annotations

import select
import sys
import threading

POLL_S = 0.1


def is_interactive() -> bool:
    """Whether standard input is a terminal, at which a person can answer."""
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def typed_line(stopped: threading.Event) -> str | None:
    """The line typed; None at the end of input, or once ``stopped`` is set."""
    while not stopped.is_set():
        try:
            ready = bool(select.select([sys.stdin], [], [], POLL_S)[0])
        except (OSError, ValueError):  # where a terminal cannot be polled (Windows), wait for the line itself
            ready = True
        if ready:
            return sys.stdin.readline() or None
    return None
