"""Absolute or relative? An RSI program that was started with RSI_ON(#RELATIVE) adds up the corrections that it is sent, so that an offset
that is held turns its arm for ever. deg.

Two looks. ``ModeProbe``, before anything is moved: a bump so small that nothing happens, which begins and ends with a correction of zero.
An absolute arm is back where it was; a relative one stands further by the sum of the bump. ``Runaway``, while the first motion begins, for
a controller that carried nothing out yet when it was probed: an arm that is ahead of every set point it was sent adds them up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import cos, pi

AXIS = 5  # the last axis moves the least behind it
PEAK_DEG = 0.004
BUMP_CYCLES = 24
_SUM_DEG = 0.5 * PEAK_DEG * BUMP_CYCLES  # how far a relative arm turns: 0.048 deg
_SHARE = 0.25  # of that: more than rounding to 0.01 deg can show, less than what an arm with a lag of 0.1 s has done in time
_MEAN_CYCLES = 8
_SIGMAS = 5.0
_AHEAD_DEG = 0.1  # more than a servo overshoots while it accelerates
_SURE_DEG = 5.0  # a relative arm would be further ahead by so much: this one is absolute
_SMALL_DEG = 0.5  # a correction of zero takes an arm back by no more than this, should the judgement be wrong


class ModeProbe:
    """``next`` in every cycle until ``done``; then ``relative`` says what the controller is."""

    def __init__(self, before: Sequence[Sequence[float]], noise_deg: float, wait_cycles: int, direction: float) -> None:
        """before: measured joints (n, 6) of the last telegrams; noise_deg: their standard deviation; wait_cycles: how far an arm may lag;
        direction: +1 or -1, where the last axis has room."""
        self._before = sum(q[AXIS] for q in before) / len(before)
        mean_of = 1.0 / len(before) + 1.0 / _MEAN_CYCLES
        self._threshold = max(_SHARE * _SUM_DEG, _SIGMAS * noise_deg * mean_of**0.5)
        self._direction, self._cycle, self._last_cycle = direction, 0, BUMP_CYCLES + wait_cycles + _MEAN_CYCLES
        self._recent: deque[float] = deque(maxlen=_MEAN_CYCLES)
        self.done = self.relative = False

    @property
    def conclusive(self) -> bool:
        """Whether the arm is quiet enough to show the difference."""
        return self._threshold < 0.75 * _SUM_DEG

    def next(self, measured: Sequence[float]) -> tuple[float, ...]:
        """The correction (6,) for this cycle, in which the joints were measured at ``measured`` (6,)."""
        self._recent.append(measured[AXIS])
        self._cycle += 1
        moved = self._direction * (sum(self._recent) / len(self._recent) - self._before)
        self.relative = len(self._recent) == _MEAN_CYCLES and moved > self._threshold
        self.done = self.relative or self._cycle >= self._last_cycle
        share = 0.0 if self.done or self._cycle >= BUMP_CYCLES else 0.5 - 0.5 * cos(2.0 * pi * self._cycle / BUMP_CYCLES)
        return (0.0,) * AXIS + (self._direction * PEAK_DEG * share,)


class Runaway:
    """Watches the beginning of a session's motion until ``sure`` that the controller is absolute."""

    def __init__(self, reference: Sequence[float], noise_deg: float) -> None:
        """reference: joints (6,) without a correction."""
        n = len(reference)
        self._reference, self._ahead = reference, max(_AHEAD_DEG, 2.0 * _SIGMAS * noise_deg)
        self._sum, self._low, self._high = [0.0] * n, [0.0] * n, [0.0] * n
        self.sure = False

    def check(self, set_point: Sequence[float], measured: Sequence[float]) -> int | None:
        """The axis that adds up its corrections, or None. set_point: joints (6,) that were asked for in the last answer."""
        for axis, reference in enumerate(self._reference):
            correction, moved = set_point[axis] - reference, measured[axis] - reference
            self._sum[axis] += correction
            self._low[axis], self._high[axis] = min(self._low[axis], correction), max(self._high[axis], correction)
            if max(self._high[axis], -self._low[axis]) > _SMALL_DEG or abs(self._sum[axis]) > _SURE_DEG:
                self.sure = True
            elif moved > self._high[axis] + self._ahead and self._sum[axis] > self._ahead:
                return axis
            elif moved < self._low[axis] - self._ahead and self._sum[axis] < -self._ahead:
                return axis
        return None
