"""The time that a simulated scanner takes, handed to the simulated arm, whose clock advances only when it is asked."""

from __future__ import annotations

import threading


class SimulatedClock:
    """What one simulated device waits, and another one has not yet let pass. Used from any thread."""

    def __init__(self) -> None:
        self._lock, self._waiting = threading.Lock(), 0.0

    def wait(self, seconds: float) -> None:
        """Let this much time pass without waiting for it."""
        with self._lock:
            self._waiting += seconds

    def take(self) -> float:
        """s that passed since the last call."""
        with self._lock:
            waited, self._waiting = self._waiting, 0.0
        return waited
