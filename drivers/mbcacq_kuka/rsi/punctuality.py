"""Was a telegram held up on its way? Answers to it come too late, so that the controller has held its set point meanwhile.

A controller sends one telegram a cycle. After a pause without a lost one, telegrams that come faster than that are those of the pause: the
network, or a computer that stood still, kept them. A peer in lock-step sends as soon as it has its answer. It also comes faster than its
own clock, but without a pause before, so it is never late.
"""

from __future__ import annotations

from math import inf

_BURST = 0.5  # of a cycle: telegrams that follow each other faster were kept somewhere
_LATE = 0.75  # of a cycle: a telegram that is so late is answered too late
_LOCK_STEP = 10.0  # cycles by which a peer is ahead of its clock: more than any network's jitter
_DRIFT = 0.02  # of a cycle each: two clocks never differ by so much


class Punctuality:
    """``take`` every telegram; ``held_up`` asks about the next one. s, on the clock of this computer."""

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._last: float | None = None
        self._behind = self._ahead = 0.0  # of the clock by which one telegram a cycle comes
        self._late_from, self._late_until = inf, -inf

    @property
    def due(self) -> float:
        """Time at which the next telegram is expected, by the controller's clock: a late one does not delay the next."""
        return inf if self._last is None else self._last + self._cycle_s - self._behind

    def held_up(self, now: float) -> bool:
        return self._late_from < now < self._late_until

    def take(self, now: float, cycles: int) -> None:
        """A telegram that came ``now``, so many cycles of the controller after the one before."""
        last, self._last = self._last, now
        if last is None:
            return
        short = cycles * self._cycle_s - (now - last)  # by so much faster than the clock
        if short < 0.0:
            self._behind, self._ahead = -short, max(0.0, self._ahead + short)
        else:
            self._ahead = max(0.0, self._ahead + max(0.0, short - self._behind) - _DRIFT * self._cycle_s)
            self._behind = max(0.0, self._behind - short)
        if self._late_until == inf:
            return
        if self._ahead > _LOCK_STEP * self._cycle_s:
            self._late_from = self._late_until = inf
            return
        self._late_from, self._late_until = now + (1.0 + _LATE) * self._cycle_s - self._behind, now + _BURST * self._cycle_s
