"""How long a diagnosis may take: the search ends in time, and what was compared until then is concluded from."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

SEARCHING = 0.6  # share of the time for the search of the whole recording; what is left is for the parts of its validation


@dataclass(frozen=True)
class TimeBudget:
    """Until when a search may go on.

    Attributes
    ----------
    begun
        Time of ``time.monotonic`` at the start, in s; the processes of one machine share that clock.
    seconds
        How long it may take; infinite by default.
    """

    begun: float = 0.0
    seconds: float = float("inf")

    @classmethod
    def of_minutes(cls, minutes: float | None) -> TimeBudget:
        """From now on; None: without an end."""
        return cls() if minutes is None else cls(time.monotonic(), 60.0 * minutes)

    @property
    def spent(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() > self.begun + self.seconds

    @property
    def for_the_search(self) -> TimeBudget:
        """The part of it in which the whole recording is searched."""
        return replace(self, seconds=SEARCHING * self.seconds)


UNLIMITED = TimeBudget()
