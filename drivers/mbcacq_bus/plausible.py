"""Whether new readings of sensors can follow the last ones: no probe jumps faster than it can, and none takes over another's value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mbcacq.devices import DeviceFault, Fact

_SAME = 0.1  # of a jump: so near to another's last value, it has landed on it
_UNUSUAL = 10.0  # times the largest step seen: two probes of nearly the same value change places by noise alone
_KNOWN = 3  # readings from which on the usual steps are known
_RECENT_S = 600.0  # two bodies may well change places in a longer time
_TEMPERATURES = ("C", "°C", "degC", "deg C", "K")
_TEMPERATURE_RATE = 0.5  # K/s: more than air in a hall or a body of metal changes by
_TEMPERATURE_STEP = 10.0  # K: a larger one is read again, however long ago the last reading was
_NOISE = 0.15  # K: of usual probes (IEC 60751, class A) and their last digit; what changes by more is read three times
_STEADY_S = 0.5  # what changes by more than its max_rate allows in this time is read three times


@dataclass(frozen=True)
class Doubt:
    """text: what cannot be, as a sentence without an end. sure: no reading of the same probes explains it."""

    text: str
    sure: bool


class Plausibility:
    """Compares each reading with the last one that was believed.

    Parameters
    ----------
    units : Mapping[str, str]
        Unit of each value by name, C without one for a name that ends in _C; only values of one unit can be exchanged.
    max_rates : Mapping[str, float]
        Largest change of a value, unit/s, where the plan gives one. Temperatures without one have a default: what changes faster is read
        again, and the second reading counts.
    """

    def __init__(self, units: Mapping[str, str], max_rates: Mapping[str, float]) -> None:
        self._units = {name: unit or ("C" if name.endswith("_C") else "") for name, unit in units.items()}
        self._max_rates = dict(max_rates)
        self._temperatures = {name for name, unit in self._units.items() if unit in _TEMPERATURES} - self._max_rates.keys()
        self._noise = dict.fromkeys(self._temperatures, _NOISE) | {name: _STEADY_S * rate for name, rate in max_rates.items()}
        self._last: dict[str, float] = {}
        self._steps: dict[str, float] = {}
        self._readings, self._at = 0, -math.inf
        self._read_again = "none"

    def checked(
        self, device: str, values: dict[str, float], again: Callable[[bool], dict[str, float]], now: Callable[[], float]
    ) -> dict[str, float]:
        """A reading, or that of ``again`` if it cannot follow the last one. Raises DeviceFault if the second cannot either.

        The very first one of values whose rate is limited is read twice: nothing else could say that it is wrong. One that changed by more
        than noise is read three times, and the middle value counts. again: reads once more; its argument says whether the first reading is
        doubted.
        """
        if not self._last and self._noise:
            self.believe(values, now())
            values = again(False)
        first = self.doubt(values, now())
        if first is None and any(
            abs(values[n] - self._last.get(n, values[n])) > self._noise[n] for n in self._noise.keys() & values.keys()
        ):
            readings, before = (values, again(False), again(False)), values
            values = {name: sorted(reading.get(name, value) for reading in readings)[1] for name, value in values.items()}
            if wrong := [
                f"{name} {before[name]:g}, then {value:g}"
                for name, value in values.items()
                if abs(before[name] - value) > self._noise.get(name, math.inf)
            ]:
                self._read_again = f"the first of three readings was another: {', '.join(wrong)}"
        if first is not None:
            values = again(True)
            second = self.doubt(values, now())
            if second is not None and second.sure:
                raise DeviceFault(f"{device}: {second.text}; check its probes, and that nothing else asks on this line")
            self._read_again = f"{first.text}; read again: {', '.join(f'{name} {value:g}' for name, value in values.items())}"
        self.believe(values, now())
        return values

    def facts(self) -> tuple[Fact, ...]:
        """The last reading that was read again, so that the recording holds it; none before the first."""
        return (Fact("doubted reading", self._read_again, critical=False),) if self._readings else ()

    def believe(self, values: Mapping[str, float], at: float) -> None:
        """Take a reading at a time ``at``, s, as the one to compare with."""
        for name, value in values.items():
            self._steps[name] = max(self._steps.get(name, 0.0), abs(value - self._last.get(name, value)))
        self._last, self._at, self._readings = dict(values), at, self._readings + 1

    def doubt(self, values: Mapping[str, float], at: float) -> Doubt | None:
        """Why a reading at a time ``at``, s, cannot follow the last; None if it can."""
        if not self._last:
            return None
        for name, rate in self._max_rates.items():
            step = abs(values[name] - self._last[name]) if name in values and name in self._last else 0.0
            if step > rate * max(at - self._at, 1.0):
                text = f"{name} went from {self._last[name]:g} to {values[name]:g} in {at - self._at:.1f} s, faster than its max_rate"
                return Doubt(text, sure=True)
        exchanged = self._exchanged(values) if at - self._at < _RECENT_S else None
        return exchanged or self._jumped(values, at)

    def _jumped(self, values: Mapping[str, float], at: float) -> Doubt | None:
        """A temperature without a rate of the plan that changed faster than temperatures do: a flipped bit, or a real jump."""
        most = min(_TEMPERATURE_RATE * max(at - self._at, 1.0), _TEMPERATURE_STEP)
        for name, value in values.items():
            if name in self._temperatures and abs(value - self._last.get(name, value)) > most:
                text = f"{name} went from {self._last[name]:g} to {value:g} in {at - self._at:.1f} s, faster than temperatures change"
                return Doubt(text, sure=False)
        return None

    def _exchanged(self, values: Mapping[str, float]) -> Doubt | None:
        landed = {name: other for name in values if (other := self._taken_over(name, values)) is not None}
        if not landed:
            return None
        pairs = ", ".join(f"{name} reads {values[name]:g} as {other} did before" for name, other in landed.items())
        return Doubt(f"values are exchanged: {pairs}", sure=self._readings >= _KNOWN and set(landed) == set(landed.values()))

    def _taken_over(self, name: str, values: Mapping[str, float]) -> str | None:
        """The other value, of the same unit, whose last reading this one shows now."""
        if name not in self._last:
            return None
        for other, before in self._last.items():
            if other == name or self._units.get(other) != self._units.get(name):
                continue
            apart = abs(before - self._last[name])
            usual = max(self._steps.get(name, 0.0), self._steps.get(other, 0.0))
            if apart > _UNUSUAL * usual and abs(values[name] - before) <= _SAME * apart:
                return other
        return None
