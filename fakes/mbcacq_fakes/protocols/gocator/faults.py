"""Faults that can be injected into a running fake sensor."""

from __future__ import annotations

import threading
from typing import Any

FAULTS = {
    "refuse_connections": "nothing listens on control, health and data port; connections that stand are kept",
    "protocol_version": "(major, minor) reported instead of the real one",
    "model": "model number reported instead of the real one",
    "silent": "set of command numbers that get no reply",
    "status": "dict of command number to the status replied instead of executing it",
    "wrong_reply": "set of command numbers that are answered as if another command had been sent",
    "close_control": "set of command numbers on which the control connection is closed",
    "mute_health": "no health messages",
    "no_data": "exposures are made but no data set is sent",
    "stamp_only": "data sets hold only their stamp",
    "old_stamp": "data sets carry a time stamp of long ago",
    "unknown_type": "a message of an unknown type comes before the surface",
    "short_message": "the surface message ends early, with a size field that agrees",
    "shifted_surface": "one flipped bit in the header of the surface shifts it by 0.512 mm",
    "garbage": "random bytes instead of a message",
    "close_data": "the data connection is closed instead of sending",
    "close_in_message": "the data connection is closed in the middle of the surface message",
    "stall": "the data connection goes silent in the middle of the surface message",
}


class Faults:
    """Settable from any thread while the sensor runs.

    ``set("stall")`` stays until ``clear("stall")``; ``set("stall", times=1)`` wears off after one data set or command.
    """

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
            if fault is None:
                self._active.clear()
            else:
                self._active.pop(fault, None)

    def get(self, fault: str) -> Any:
        """The value while the fault is active, else None. Does not wear it off."""
        with self._lock:
            return self._active.get(fault, (None, None))[0]

    def use(self, fault: str, command: int | None = None) -> Any:
        """As ``get``, and count it down. With ``command``, only if the fault concerns that command number."""
        with self._lock:
            value, times = self._active.get(fault, (None, None))
            if value is None or (command is not None and command not in value):
                return None
            if times is not None:
                self._active[fault] = (value, times - 1)
                if times <= 1:
                    del self._active[fault]
            return value if command is None or not isinstance(value, dict) else value[command]
