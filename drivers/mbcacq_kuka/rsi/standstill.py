"""Does the arm stand? Encoders are never still, so means are compared, against the noise that the arm shows at rest. deg."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

_HALF_S = 0.024  # two windows of this length, one after the other, are compared
_SLOW_DEG_S = 0.125  # less is standing still
_SIGMAS = 5.0  # six axes, 250 times a second: false once in some hours
_NOISE_S = 0.25  # set points rest for so long, which is longer than arms lag: noise is learnt
_MEMORY = 64  # cycles of noise that count


def noise_of(samples: Sequence[Sequence[float]]) -> list[float]:
    """Standard deviation (6,) of white noise from joints (n, 6) of consecutive cycles: by their differences, which a slow motion hardly
    changes."""
    pairs = list(zip(samples, samples[1:], strict=False))
    if not pairs:
        return [0.0] * len(samples[0])
    return [(sum((b[k] - a[k]) ** 2 for a, b in pairs) / (2.0 * len(pairs))) ** 0.5 for k in range(len(samples[0]))]


class Standstill:
    """``take`` the measured joints of every cycle. ``mean`` (6,) is that of the newest window; ``cycles``: how long the arm has been
    standing; ``variance`` (6,), deg^2: of an axis at rest."""

    def __init__(self, start: Sequence[float], noise_deg: Sequence[float], cycle_s: float) -> None:
        """start: joints (6,); noise_deg: standard deviation (6,) of each axis at rest."""
        self._half = max(3, round(_HALF_S / cycle_s))
        self._new: deque[Sequence[float]] = deque([start] * self._half)
        self._old: deque[Sequence[float]] = deque([start] * self._half)
        self._sums = [[v * self._half for v in start] for _ in range(2)]
        self.variance = [v * v for v in noise_deg]
        self._slow = _SLOW_DEG_S * self._half * cycle_s
        self.mean: tuple[float, ...] = tuple(start)
        self.cycles = self._asked_to_rest = 0
        self._learns_after = round(_NOISE_S / cycle_s)

    def take(self, measured: Sequence[float], commanded_to_move: bool) -> None:
        """The next cycle's joints (6,); ``commanded_to_move``: set points still change, so that a pause is no standstill."""
        before, half = self._new[-1], self._half
        leaving, forgotten = self._new.popleft(), self._old.popleft()
        self._new.append(measured)
        self._old.append(leaving)
        new, old = self._sums
        still, mean = True, []
        for axis, value in enumerate(measured):
            new[axis] += value - leaving[axis]
            old[axis] += leaving[axis] - forgotten[axis]
            most = self._slow + _SIGMAS * (2.0 * self.variance[axis] / half) ** 0.5
            still = still and abs(new[axis] - old[axis]) < most * half
            mean.append(new[axis] / half)
        self.mean = tuple(mean)
        self.cycles = self.cycles + 1 if still and not commanded_to_move else 0
        self._asked_to_rest = 0 if commanded_to_move else self._asked_to_rest + 1
        if self._asked_to_rest > self._learns_after:
            # How noisy is it here? By changes from cycle to cycle, which a motion of its own hardly adds to: also of an arm that seems to
            # move because it hums more in this posture than where it began.
            for axis, value in enumerate(measured):
                change = value - before[axis]
                self.variance[axis] += (0.5 * change * change - self.variance[axis]) / _MEMORY
