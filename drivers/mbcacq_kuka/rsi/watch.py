"""Does the arm do what it is asked to? Compares measured and commanded joint angles, one robot cycle after the other. deg.

An arm follows its commands with a lag. Whatever the shape of that lag, its position is a weighted mean of past commands and its speed a
weighted mean of past commanded speeds. Both therefore lie between the smallest and the largest of the last cycles. An arm that stands still
when it should move, or moves when it should not, leaves one of the two bands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

_BLOCK = 8  # cycles; bounds are kept by block, so that the oldest can be forgotten without going through every cycle
_SPAN_S = 0.048  # speeds are compared as angles travelled in this time: long enough to stand out from rounded angles
_OVERSHOOT = 0.25  # share of the commanded speed by which a servo may be off for longer than a moment
_FROZEN_CYCLES = 6  # outside the band of speeds
_JUMP_DEG = 0.25  # rounding of the telegrams
_JUMP_SHARE = 2.0  # of the axis' largest speed: an arm cannot, a telegram that arrives a cycle late can look like it


class Band:
    """Smallest and largest of the values of the last cycles (n,), and how long a measured value has been outside."""

    def __init__(self, start: Sequence[float], tolerance: float, share: float, blocks: int) -> None:
        """``tolerance``: outside by so much more than ``share`` of the largest magnitude in the band is outside. The band
        reaches back ``blocks`` blocks."""
        self._tolerance, self._share, self.outside = tolerance, share, 0
        self._past: deque[tuple[list[float], list[float]]] = deque(maxlen=blocks)
        self._begin_block(start)

    def check(self, command: Sequence[float], measured: Sequence[float]) -> int | None:
        """An axis that is outside now, or None; ``outside`` counts the cycles for which it has been."""
        low, high, past_low, past_high = self._low, self._high, self._past_low, self._past_high
        found = None
        for axis, value in enumerate(command):
            if value < low[axis]:
                low[axis] = value
            elif value > high[axis]:
                high[axis] = value
            least, most = min(low[axis], past_low[axis]), max(high[axis], past_high[axis])
            slack = self._tolerance + self._share * max(-least, most)
            if not least - slack <= measured[axis] <= most + slack:
                found = axis
        self._count += 1
        if self._count == _BLOCK:
            self._past.append((low, high))
            self._begin_block(command)
        self.outside = 0 if found is None else self.outside + 1
        return found

    def _begin_block(self, command: Sequence[float]) -> None:
        self._count, self._low, self._high = 0, list(command), list(command)
        lows = [low for low, _ in self._past] or [self._low]
        highs = [high for _, high in self._past] or [self._high]
        self._past_low = [min(v) for v in zip(*lows, strict=True)]
        self._past_high = [max(v) for v in zip(*highs, strict=True)]


class Follow:
    """Position and speed of every axis against their bands. ``lag_s`` (s) is how far the arm may lag behind its commands."""

    def __init__(self, start: Sequence[float], tolerance: float, cycles: int, lag_s: float, cycle_s: float) -> None:
        self._tolerance, self._allowed = tolerance, cycles
        self._blocks = max(1, round(lag_s / (cycle_s * _BLOCK)))
        self._span = max(3, round(_SPAN_S / cycle_s))
        self._position = Band(start, tolerance, 0.0, self._blocks)
        self._commands: deque[Sequence[float]] = deque(maxlen=self._span)
        self._measured: deque[Sequence[float]] = deque(maxlen=self._span)
        self._speed: Band | None = None
        self._unsure = 0

    def skip(self, measured: Sequence[float], cycles: int) -> None:
        """So many telegrams before the one with ``measured`` are missing: the controller held its last set point meanwhile."""
        if cycles > _BLOCK or not self._commands:
            self._commands.clear()
            self._measured.clear()
            self._speed, self._unsure = None, self._blocks * _BLOCK  # until the band of speeds reaches back as far as the arm may lag
            return
        held, last = self._commands[-1], self._measured[-1]
        for k in range(1, cycles + 1):
            self.check(held, [a + (b - a) * k / (cycles + 1) for a, b in zip(last, measured, strict=True)])

    def check(self, command: Sequence[float], measured: Sequence[float]) -> int | None:
        """The axis that has not followed for the allowed number of cycles, or None."""
        speed_axis = self._check_speed(command, measured)
        axis = self._position.check(command, measured)
        return axis if axis is not None and self._position.outside >= self._allowed else speed_axis

    def _check_speed(self, command: Sequence[float], measured: Sequence[float]) -> int | None:
        axis = None
        if len(self._commands) == self._span:
            asked = [now - then for now, then in zip(command, self._commands[0], strict=True)]
            moved = [now - then for now, then in zip(measured, self._measured[0], strict=True)]
            if self._speed is None:
                self._speed = Band(asked, self._tolerance, _OVERSHOOT, self._blocks)
            found = self._speed.check(asked, moved)
            self._unsure = max(0, self._unsure - 1)
            axis = found if not self._unsure and self._speed.outside >= _FROZEN_CYCLES else None
        self._commands.append(command)
        self._measured.append(measured)
        return axis


class Jump:
    """No axis turns further in a cycle than it can."""

    def __init__(self, start: Sequence[float], speed_deg_s: Sequence[float], cycle_s: float) -> None:
        self._last = start
        self._most = [_JUMP_SHARE * v * cycle_s for v in speed_deg_s]

    def check(self, measured: Sequence[float], cycles: int) -> tuple[int, float] | None:
        """The axis that moved too far since the telegram so many ``cycles`` ago, and how far; or None."""
        last, self._last = self._last, measured
        for axis, (now, then, most) in enumerate(zip(measured, last, self._most, strict=True)):
            if abs(now - then) > most * cycles + _JUMP_DEG:
                return axis, now - then
        return None
