"""What RSI does with answers: accept, discard, count, clamp, watch, stop. One object an RSI session; deg."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq_fakes.protocols.krc.settings import KrcSettings
from mbcacq_fakes.protocols.krc.wire import RsiAnswer

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
OPERATOR, LATE, OVERSPEED, MONITOR, SOFT_LIMIT, ACCELERATION = 1, 2, 3, 4, 5, 6  # indices into arm_state.FAULTS
PC_STOP = 0
LED_DEG_S = 40.0  # of every axis, by a program on the controller


class FakeRsiSession:
    """From RSI_ON to RSI_OFF. ``set_point`` is where the arm shall be; ``ended`` is None or why the session is over."""

    def __init__(self, settings: KrcSettings, start: Sequence[float]) -> None:
        self._settings, self.start = settings, tuple(start)
        self._correction: tuple[float, ...] = (0.0,) * 6
        self.applied: tuple[float, ...] = (0.0,) * 6
        self.set_point = self.start
        self.active = False  # an operator waits: nothing is counted before the first valid answer
        self.delay = 0
        self.ended: int | None = None
        self.outputs = dict.fromkeys(settings.digital_outputs, False)  # the program begins with all of them off
        self._largest_step = [v * settings.overspeed * settings.cycle_ms * 1e-3 + 1e-6 for v in settings.speed_deg_s]
        fastest = settings.acceleration_deg_s2
        self._largest_change = (
            None if fastest is None else [v * settings.overspeed * (settings.cycle_ms * 1e-3) ** 2 + 4e-6 for v in fastest]
        )
        self._asked: tuple[tuple[float, ...], ...] = ()  # corrections of the last cycles without a missing answer
        self._range: tuple[float | None, list[tuple[float, float]]] | None = None

    @property
    def correction(self) -> tuple[float, ...]:
        """(6,) deg, that the controller has."""
        return self._correction

    def accept(self, answer: RsiAnswer | None, ipoc: int) -> bool:
        """True for an answer with the right IPOC and type; anything else is thrown away without a word."""
        if answer is None or answer.ipoc != str(ipoc) or answer.sen_type != self._settings.sen_type:
            return False
        self.active = True
        self.outputs = {number: answer.outputs.get(number, False) for number in self.outputs}  # HOLDON="0"
        if self._settings.counting == "consecutive":
            self.delay = 0
        if answer.stop:
            self.ended = PC_STOP
            return True
        held = self._correction if self._settings.hold_on else (0.0,) * 6
        given = answer.correction
        self._correction = tuple([given.get(axis, old) for axis, old in zip(AXES, held, strict=True)]) if given else held
        self._asked = (*self._asked[-2:], self._correction)
        return True

    def miss(self, rejected: bool) -> None:
        """A cycle without a valid answer; ``rejected``: one came in time and was thrown away."""
        if not (self.active or rejected):
            return
        self._asked = ()
        self.outputs = dict.fromkeys(self.outputs, False)
        self.delay += 1
        if not self._settings.hold_on:
            self._correction = (0.0,) * 6
        if self.delay >= self._settings.timeout:
            self.ended = LATE

    def lead(self, target: Sequence[float]) -> None:
        """The controller's own program moves the arm on towards ``target`` (6,) deg; corrections come on top of it."""
        step = LED_DEG_S * self._settings.cycle_ms * 1e-3
        self.start = tuple([s + min(max(t - s, -step), step) for s, t in zip(self.start, target, strict=True)])
        self.set_point = tuple([s + c for s, c in zip(self.start, self.applied, strict=True)])
        self._range = None

    def apply(self, clamp_deg: float | None, ignore: bool) -> None:
        """Carry the accepted correction out. Called once a cycle."""
        wanted = self.applied if ignore else self._correction
        if wanted == self.applied:
            return
        if self._is_too_steep():
            self.ended = ACCELERATION
        bounds = self._bounds(clamp_deg)
        wanted = tuple([low if v < low else high if v > high else v for v, (low, high) in zip(wanted, bounds, strict=True)])
        watch = self._settings.monitor_deg
        for value, before, largest in zip(wanted, self.applied, self._largest_step, strict=True):
            if abs(value - before) > largest:
                self.ended = OVERSPEED
            elif watch is not None and abs(value) > watch:
                self.ended = MONITOR
        if self.ended is None:
            self.applied = wanted
            self.set_point = tuple([s + c for s, c in zip(self.start, wanted, strict=True)])

    def _is_too_steep(self) -> bool:
        if self._largest_change is None or len(self._asked) < 3:
            return False
        return any(abs(a - 2.0 * b + c) > most for a, b, c, most in zip(*self._asked, self._largest_change, strict=True))

    def _bounds(self, clamp_deg: float | None) -> list[tuple[float, float]]:
        """Range of each axis' correction: up to the software limits, as our KRL program opens it, or AXISCORR's own."""
        if self._range is None or self._range[0] != clamp_deg:
            reach = float("inf") if clamp_deg is None else clamp_deg
            limits = zip(self._settings.limits_deg, self.start, strict=True)
            self._range = (clamp_deg, [(max(low - s, -reach), min(high - s, reach)) for (low, high), s in limits])
        return self._range[1]
