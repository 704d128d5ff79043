"""What the devices said of themselves when a run began (load, tool, exposure, job) is compared with what they say while it goes on."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from mbcacq.acquisition import events
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.devices import Device, Fact


class FactWatch:
    """``look`` often, from any thread; ``mark`` where a pose begins, ``since_mark`` where it ends.

    Every change is recorded with both values. The reference is what a device said first, in a resumed run what was ``recorded`` before:
    poses under another value are left out until the value is back, as they cannot be compared with those before.
    """

    def __init__(self, devices: Mapping[str, Device], bus: EventBus, recorded: Mapping[str, str] | None = None) -> None:
        self._devices, self._bus, self._recorded = devices, bus, recorded or {}
        self._first: dict[tuple[str, str], Fact] = {}
        self._now: dict[tuple[str, str], Fact] = {}
        self._strange: dict[tuple[str, str], str] = {}
        self._lock = threading.RLock()

    @property
    def values(self) -> dict[str, str]:
        """The present values by role and name, e.g. ``{"robot load": "2.3 kg"}``."""
        with self._lock:
            return {f"{role} {name}": fact.text for (role, name), fact in self._now.items()}

    def look(self) -> None:
        """Compare every fact with the last and with the first that its device gave."""
        with self._lock:
            for role, device in self._devices.items():
                for fact in getattr(device, "facts", tuple)():
                    self._compare(role, fact)

    def mark(self) -> None:
        """A pose begins: forget what was strange before it, if it is not any more."""
        with self._lock:
            self._strange.clear()
            self.look()

    def since_mark(self) -> str:
        """Which value was another one than at the beginning of the run, as a clause with both; '' if none was."""
        with self._lock:
            self.look()
            return next(iter(self._strange.values()), "")

    def _compare(self, role: str, fact: Fact) -> None:
        key = role, fact.name
        if key not in self._first:
            text = self._recorded.get(f"{role} {fact.name}")
            self._first[key] = fact if text is None else fact.recorded(text)
        first = self._first[key]
        before = self._now.get(key, first)
        self._now[key] = fact
        if fact.critical and fact.differs(first):
            self._strange[key] = f"the {role} reported {fact.name} {fact.text}, but {first.text} when the run began"
        if fact.differs(before):
            self._bus.emit(events.FactChanged, role, fact.name, before.text, fact.text)
            self._bus.message("warning", f"{role}: {fact.name} changed from {before.text} to {fact.text}")
