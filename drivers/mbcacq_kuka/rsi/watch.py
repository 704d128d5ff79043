"""Does the arm do what it is told? Compares measured and commanded joint angles, one robot cycle after the other. deg."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

_BLOCK, _BLOCKS = 8, 10  # the arm may lag this many cycles (0.32 s at 4 ms) behind its command


class Follow:
    """The measured angle must lie between the smallest and the largest command of the last cycles, within a tolerance.

    So a lag of any shape is fine, while an arm that stands still when it should move is found soon after.
    """

    def __init__(self, start: Sequence[float], tolerance: float, cycles: int) -> None:
        self._tolerance, self._allowed, self._outside = tolerance, cycles, 0
        self._past: deque[tuple[list[float], list[float]]] = deque(maxlen=_BLOCKS)
        self._begin_block(start)

    def check(self, command: Sequence[float], measured: Sequence[float]) -> int | None:
        """The axis that has not followed for the allowed number of cycles, or None."""
        low, high, past_low, past_high = self._low, self._high, self._past_low, self._past_high
        tolerance, outside = self._tolerance, None
        for axis, value in enumerate(command):
            if value < low[axis]:
                low[axis] = value
            elif value > high[axis]:
                high[axis] = value
            if not min(low[axis], past_low[axis]) - tolerance <= measured[axis] <= max(high[axis], past_high[axis]) + tolerance:
                outside = axis
        self._count += 1
        if self._count == _BLOCK:
            self._past.append((low, high))
            self._begin_block(command)
        if outside is None:
            self._outside = 0
            return None
        self._outside += 1
        return outside if self._outside >= self._allowed else None

    def _begin_block(self, command: Sequence[float]) -> None:
        """Bounds are kept by block, so that the oldest can be forgotten without going through every cycle."""
        self._count, self._low, self._high = 0, list(command), list(command)
        lows = [low for low, _ in self._past] or [self._low]
        highs = [high for _, high in self._past] or [self._high]
        self._past_low = [min(v) for v in zip(*lows, strict=True)]
        self._past_high = [max(v) for v in zip(*highs, strict=True)]
