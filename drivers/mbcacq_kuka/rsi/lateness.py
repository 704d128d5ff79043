"""How many answers the controller discards, from the ``Delay`` of its telegrams."""

from __future__ import annotations

from collections import deque


class Lateness:
    """Whether a controller counts late answers in a row or in all is not established, so both a rising and a falling count are taken."""

    def __init__(self, delay: float, limit: int, window_s: float) -> None:
        """``limit`` answers may be discarded within ``window_s`` on the robot's clock; 0: within the session."""
        self._delay, self._limit, self._window_s = delay, limit, window_s
        self._rises: deque[tuple[float, float]] = deque()
        self.count = self.total = 0.0

    def rise(self, delay: float, time_s: float) -> float:
        """By how much the count has risen since the last telegram; 0 where it fell back."""
        rise, self._delay = max(0.0, delay - self._delay), delay
        if rise:
            self._rises.append((time_s, rise))
            self.count += rise
            self.total += rise
        while self._window_s and self._rises and time_s - self._rises[0][0] > self._window_s:
            self.count -= self._rises.popleft()[1]
        return rise

    @property
    def in_words(self) -> str:
        """What the whole session says of a controller that has fallen silent, '' if it has discarded nothing."""
        if not self.total:
            return ""
        answers = "1 answer" if self.total == 1 else f"{self.total:.0f} answers"
        return (
            f"; by its Delay it had discarded {answers} of this session as late or invalid, and it ends a session by itself after some; "
            "check the network and the load of this computer"
        )

    @property
    def too_many(self) -> bool:
        return self.count > self._limit
