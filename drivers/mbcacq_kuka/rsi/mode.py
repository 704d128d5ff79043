"""Absolute or relative? An RSI program that was started with RSI_ON(#RELATIVE) adds up the corrections that it is sent, so that an offset
that is held turns its arm for ever. deg.

``ModeProbe``, before anything is moved: a bump so small that nothing happens, which begins and ends with a correction of zero. An absolute
arm is seen to come and go; a relative one stands further by the sum of the bump. A controller that carries nothing out yet, because its
program has not reached RSI_MOVECORR, shows neither: then ``Proof`` comes before the first motion.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import cos, pi

from mbcacq_kuka.rsi.motion import RsiMotion
from mbcacq_kuka.rsi.shared import MOVE, RsiCommand

AXIS = 5  # the last axis moves the least behind it
PEAK_DEG = 0.004
BUMP_CYCLES = 24
_SUM_DEG = 0.5 * PEAK_DEG * BUMP_CYCLES  # how far a relative arm turns: 0.048 deg
_SHARE = 0.25  # of that: more than rounding to 0.01 deg can show, less than what an arm with a lag of 0.1 s has done in time
_MEAN_CYCLES = 8
_SIGMAS = 5.0
_SURE_SIGMAS = 8.0  # of the largest of many means, with a standard deviation from some 60 telegrams
_STEPS = 1.9  # of the written angles: one step up and one down may be the rounding of an arm that stands
_SMALLEST_DEG, _LARGEST_DEG = 0.006, 0.25  # of the proof; a tenth of a degree is the coarsest that controllers write
_CLEAR = 4.0  # times what can just be seen: an arm with a lag of 0.1 s shows 0.4 of it
_TIMES = 3.0  # further than so many times the correction: no servo overshoots so, an arm that adds it up does within 14 cycles
_LONGER = 3  # times the usual lag, for controllers that think
ATTEMPTS = 6  # 3.6 s at 4 ms, for who must still acknowledge the message of RSI_MOVECORR


class Response:
    """``take`` what the last axis does while it is sent a bump: means of eight telegrams against where it stood. ``moved``: deg in the
    bump's direction."""

    def __init__(self, before: Sequence[float], direction: float) -> None:
        """before: angles of the last axis (n,) in front of the bump."""
        self._before, self._direction, self._peak = sum(before) / len(before), direction, 0.0
        self.recent: deque[float] = deque(maxlen=_MEAN_CYCLES)
        self.moved = 0.0

    def take(self, angle: float) -> None:
        self.recent.append(angle)
        if self.full:
            self.moved = self._direction * (sum(self.recent) / _MEAN_CYCLES - self._before)
            self._peak = max(self._peak, self.moved)

    @property
    def full(self) -> bool:
        return len(self.recent) == _MEAN_CYCLES

    def came_and_went(self, step_deg: float, noise_deg: float) -> bool:
        """Whether the arm was seen to do what an absolute controller does. step_deg: of the written angles; noise_deg: their standard
        deviation, of so many telegrams that it is known."""
        return self._peak - max(0.0, self.moved) >= max(visible(noise_deg), _STEPS * step_deg)


def visible(noise_deg: float) -> float:
    """The smallest difference of two means of eight that is none of the noise."""
    return _SURE_SIGMAS * noise_deg * (2.0 / _MEAN_CYCLES) ** 0.5


class ModeProbe:
    """``next`` in every cycle until ``done``; then ``relative`` says what the controller is, and ``response`` what its arm did."""

    def __init__(self, before: Sequence[Sequence[float]], noise_deg: float, wait_cycles: int, direction: float) -> None:
        """before: measured joints (n, 6) of the last telegrams; noise_deg: their standard deviation; wait_cycles: how far an arm may lag;
        direction: +1 or -1, where the last axis has room."""
        self.response = Response([q[AXIS] for q in before], direction)
        mean_of = 1.0 / len(before) + 1.0 / _MEAN_CYCLES
        self._threshold = max(_SHARE * _SUM_DEG, _SIGMAS * noise_deg * mean_of**0.5)
        self._direction, self._cycle, self._last_cycle = direction, 0, BUMP_CYCLES + wait_cycles + _MEAN_CYCLES
        self.done = self.relative = False

    @property
    def conclusive(self) -> bool:
        """Whether the arm is quiet enough to show the difference."""
        return self._threshold < 0.75 * _SUM_DEG

    def next(self, measured: Sequence[float]) -> tuple[float, ...]:
        """The correction (6,) for this cycle, in which the joints were measured at ``measured`` (6,)."""
        self.response.take(measured[AXIS])
        self._cycle += 1
        self.relative = self.response.full and self.response.moved > self._threshold
        self.done = self.relative or self._cycle >= self._last_cycle
        share = 0.0 if self.done or self._cycle >= BUMP_CYCLES else 0.5 - 0.5 * cos(2.0 * pi * self._cycle / BUMP_CYCLES)
        return (0.0,) * AXIS + (self._direction * PEAK_DEG * share,)


class Proof:
    """No motion begins before the arm was seen to carry out an absolute correction. The last axis is moved by a little, waits, and goes
    back. This ends when the correction is ``seen``, when the arm runs away (``relative``), or when it has done nothing for ``ATTEMPTS``
    (``in_vain``). Stopped meanwhile it goes back to a correction of zero, at which an arm of either kind stands."""

    def __init__(self, reference: Sequence[float], noise_deg: float, step_deg: float, wait_cycles: int, direction: float) -> None:
        """reference: joints (6,) without a correction; step_deg: of the written angles; else as ModeProbe."""
        self._reference, self._direction, self._step = tuple(reference), direction, step_deg
        self._noise, self._wait = noise_deg, wait_cycles
        self._peak = min(max(_SMALLEST_DEG, _CLEAR * visible(noise_deg), _CLEAR * step_deg), _LARGEST_DEG)
        self._begin()
        self.wanted: RsiCommand | None = None  # the motion that waits
        self._limits = RsiCommand(MOVE)
        self._stopped = False
        self.seen = self.relative = False

    def _begin(self) -> None:
        self._response = Response([self._reference[AXIS]], self._direction)
        self._attempt = self._rested = 0
        self._out = False

    def ask(self, command: RsiCommand) -> None:
        """The motion that shall begin afterwards; the limits of its speed, acceleration and jerk hold for the proof, too."""
        if self._stopped or self.wanted is None:
            self._begin()
        self.wanted = self._limits = command
        self._stopped = False

    def stop(self, motion: RsiMotion) -> None:
        """Back to a correction of zero; ``wanted`` is given up once ``motion`` is there."""
        self._stopped = True
        if self.wanted is not None:
            self._move(motion, 0.0)

    @property
    def in_vain(self) -> bool:
        return self._attempt > ATTEMPTS

    def advance(self, motion: RsiMotion, measured: Sequence[float]) -> None:
        """Every cycle while a motion is ``wanted``: look at the joints ``measured`` (6,), and ask ``motion`` for the next thing."""
        response = self._response
        response.take(measured[AXIS])
        self.relative = self._attempt > 0 and response.full and response.moved > _TIMES * self._peak
        self._rested = 0 if motion.moving else self._rested + 1
        if self._stopped:
            self.wanted = None if self._rested else self.wanted
            return
        wait = self._wait * min(max(1, self._attempt), _LONGER)
        if self.relative or self._rested < (wait if self._out else wait + _MEAN_CYCLES) and self._attempt or not response.full:
            return
        if self._out:
            self._out = False
            self._move(motion, 0.0)
            return
        self.seen = self._attempt > 0 and response.came_and_went(self._step, self._noise)
        if self.seen:
            return
        self._attempt += 1
        if not self.in_vain:
            self._response = Response(response.recent, self._direction)
            self._out, self._rested = True, 0
            self._move(motion, self._peak)

    def _move(self, motion: RsiMotion, offset_deg: float) -> None:
        target = (*self._reference[:AXIS], self._reference[AXIS] + self._direction * offset_deg)
        motion.move(replace(self._limits, target=target))
