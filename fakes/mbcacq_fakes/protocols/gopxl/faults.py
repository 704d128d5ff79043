"""Faults that a running fake GoPxL sensor can be given."""

from __future__ import annotations

import threading
from typing import Any

FAULTS = {
    "refuse_connections": "nothing listens on the control and the data port; connections that stand are kept",
    "silent": "set of paths that get no reply",
    "status": "dict of path to the status replied instead of executing the request",
    "close_control": "set of paths on which the control connection is closed",
    "notifications": "number of notifications and stream messages sent before every reply",
    "no_data": "exposures are made but no data set is sent",
    "stamp_only": "data sets hold only their stamp",
    "null_surface": "a null message with this status comes instead of the surface",
    "old_frame": "the stamp carries the frame index of long ago",
    "unknown_type": "a message of a type nobody knows comes before the surface",
    "short_message": "the surface message ends early, with a size field that agrees",
    "garbage": "random bytes instead of a message",
    "close_data": "the data connection is closed instead of sending",
    "close_in_message": "the data connection is closed in the middle of the surface message",
    "stall": "the data connection goes silent in the middle of the surface message",
}


class GoPxLFaults:
    """Settable from any thread; ``times`` says after how many data sets or requests a fault wears off, None for never."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._active: dict[str, tuple[Any, int | None]] = {}

    def set(self, fault: str, value: Any = True, times: int | None = None) -> None:
        if fault not in FAULTS:
            raise ValueError(f"there is no fault '{fault}' (known: {', '.join(FAULTS)})")
        with self._lock:
            self._active[fault] = (value, times)

    def clear(self, fault: str | None = None) -> None:
        """One fault, or all."""
        with self._lock:
            for name in [fault] if fault else list(self._active):
                self._active.pop(name, None)

    def get(self, fault: str) -> Any:
        """The value while the fault is active, else None; does not wear it off."""
        with self._lock:
            return self._active.get(fault, (None, None))[0]

    def use(self, fault: str, path: str | None = None) -> Any:
        """As ``get``, and count it down; with ``path``, only if the fault concerns that path."""
        with self._lock:
            value, times = self._active.get(fault, (None, None))
            if value is None or (path is not None and path not in value):
                return None
            if times is not None:
                self._active[fault] = (value, times - 1)
                if times <= 1:
                    del self._active[fault]
            return value[path] if path is not None and isinstance(value, dict) else value
