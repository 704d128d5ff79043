"""The last look at a set point before it is sent: no axis may be asked for more than it can do, whoever asks. deg, s.

A difference quotient of a motion is a weighted mean of its derivative over the cycles that it spans (mean value theorem), so a motion
within its limits has no quotient beyond them.
"""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq_kuka.rsi.shared import RsiCommand

_ROUNDING = 1e-3  # share of a limit
_UNITS = ("°/s", "°/s²", "°/s³")
_NAMES = ("turn at", "accelerate with", "jerk with")

Dynamics = tuple[list[float], list[float], list[float]]


class StepLimits:
    """Set points of one arm, one a cycle, against the axes' limits. ``dynamics``: largest speed, acceleration and jerk of each axis."""

    def __init__(self, start: Sequence[float], joint_limits: Sequence[tuple[float, float]], dynamics: Dynamics, cycle_s: float) -> None:
        self.dynamics, self._joint_limits, self._cycle_s = dynamics, joint_limits, cycle_s
        self._most = [[(1.0 + _ROUNDING) * v * cycle_s**order for v in limit] for order, limit in enumerate(dynamics, 1)]
        self.rest(start)

    def too_fast(self, command: RsiCommand) -> str:
        """Why a motion must not be made; '' for one that may."""
        for order, (asked, limit) in enumerate(zip((command.speed, command.acceleration, command.jerk), self.dynamics, strict=True)):
            for axis, (value, most) in enumerate(zip(asked, limit, strict=True)):
                if not value <= (1.0 + _ROUNDING) * most:
                    return f"A{axis + 1} would {_NAMES[order]} {value:.0f} {_UNITS[order]}, its limit is {most:.0f}; nothing was moved"
        return ""

    def rest(self, position: Sequence[float]) -> None:
        """The arm stands at ``position``."""
        self._position = tuple(position)
        self._past = [(0.0, 0.0)] * len(self._position)  # last differences of first and second order, of each axis

    def refusal(self, position: Sequence[float]) -> str:
        """Why the next set point must not be sent; '' for one that may. Nothing is remembered of it before ``take``."""
        for axis, (now, before, (step, change)) in enumerate(zip(position, self._position, self._past, strict=True)):
            low, high = self._joint_limits[axis]
            if not min(low, before) - 1e-9 <= now <= max(high, before) + 1e-9:  # an arm that stands outside may come back
                return f"A{axis + 1} would go to {now:.3f}°, outside its limits {low:g}..{high:g}°"
            first = now - before
            differences = (first, first - step, first - step - change)
            for order, (value, most) in enumerate(zip(differences, self._most, strict=True)):
                if abs(value) > most[axis]:
                    asked = abs(value) / self._cycle_s ** (order + 1)
                    return f"A{axis + 1} would {_NAMES[order]} {asked:.0f} {_UNITS[order]}, its limit is {self.dynamics[order][axis]:.0f}"
        return ""

    def take(self, position: Sequence[float]) -> None:
        """The next set point, which will be sent."""
        steps = [now - before for now, before in zip(position, self._position, strict=True)]
        self._past = [(step, step - old) for step, (old, _) in zip(steps, self._past, strict=True)]
        self._position = tuple(position)
