"""Events to subscribers, from the runner's thread and the cycle collector's."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from mbcacq.acquisition.events import Event, Gap, Message, StateChanged

Subscriber = Callable[[Event], None]


class EventBus:
    """Hands each event to every subscriber, one event at a time. An error of one (a full disk) keeps it from no other and then reaches
    the emitter."""

    def __init__(self, subscribers: Iterable[Subscriber] = ()) -> None:
        self._subscribers = list(subscribers)
        self._lock = threading.RLock()
        self._start = time.monotonic()

    def subscribe(self, subscriber: Subscriber) -> None:
        """Deliver events from now on to one more, after all others."""
        self._subscribers.append(subscriber)

    @property
    def elapsed(self) -> float:
        """Seconds since the run started."""
        return time.monotonic() - self._start

    def emit(self, kind: type[Event], *args, **fields) -> None:
        """Build ``kind(time_s=now, ...)`` and deliver it."""
        with self._lock:
            event, failure = kind(self.elapsed, *args, **fields), None
            for subscriber in self._subscribers:
                try:
                    subscriber(event)
                except Exception as error:
                    failure = failure or error
            if failure is not None:
                raise failure

    def state(self, state: str) -> None:
        """The run enters a state, see ``StateChanged``."""
        self.emit(StateChanged, state)

    def message(self, level: str, text: str) -> None:
        """A sentence for the operator, see ``Message``."""
        self.emit(Message, level, text)

    def gap(self, kind: str, text: str, pose: int | None = None) -> None:
        """Something the recording lacks, see ``Gap``; a warning says the same."""
        self.emit(Gap, kind, text, pose)
        self.message("warning", text)
