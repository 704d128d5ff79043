"""What the sensor's health values mean for a run: nothing, a warning, or the end of it."""

from __future__ import annotations

from collections.abc import Mapping

from mbcacq.devices import DeviceFault

_BACK_K = 2.0  # a warning comes again only after the sensor has cooled down by so much
_DROPS = {
    "processing_drops": "scans that it could not process",
    "trigger_drops": "triggers that came too fast",
    "output_drops": "scans that the network did not take",
}


class HealthGuard:
    """Limits in degrees Celsius for every temperature the sensor reports; None for none."""

    def __init__(self, warning_C: float | None, stop_C: float | None) -> None:
        self._warning_C, self._stop_C = warning_C, stop_C
        self._warned: set[str] = set()
        self._drops: dict[str, float] = {}
        self._silent = False

    def look(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Warnings that are news. Raises DeviceFault above the stop limit, or if the sensor itself reports that it overheats."""
        temperatures = {name: value for name, value in values.items() if name.split(".")[0].endswith("_C")}
        for name, value in temperatures.items():
            if self._stop_C is not None and value > self._stop_C:
                raise DeviceFault(
                    f"the Gocator's {_plain(name)} is {value:g} C, above the plan's {self._stop_C:g} C; let it cool down, "
                    "and give it a heat sink or air"
                )
        if values.get("overheat", 0) > 0:
            raise DeviceFault("the Gocator reports that it is overheated; let it cool down")
        return (*self._warm(temperatures), *self._dropped(values), *self._quiet(temperatures))

    def _warm(self, temperatures: Mapping[str, float]) -> list[str]:
        news = []
        for name, value in temperatures.items():
            if self._warning_C is None:
                break
            if value > self._warning_C and name not in self._warned:
                self._warned.add(name)
                news.append(f"the Gocator's {_plain(name)} is {value:g} C, above {self._warning_C:g} C: its measurements drift")
            elif value < self._warning_C - _BACK_K:
                self._warned.discard(name)
        return news

    def _dropped(self, values: Mapping[str, float]) -> list[str]:
        news = []
        for name, meaning in _DROPS.items():
            now, before = values.get(name), self._drops.get(name)
            if now is not None:
                self._drops[name] = now
                if before is not None and now > before:
                    news.append(f"the Gocator counts {now - before:g} more {meaning}")
        return news

    def _quiet(self, temperatures: Mapping[str, float]) -> list[str]:
        """Limits that nothing is compared with are reported once."""
        silent = not temperatures and (self._warning_C, self._stop_C) != (None, None)
        news, self._silent = silent and not self._silent, silent
        return ["the Gocator reports no temperature, so the limits of the plan are not watched"] if news else []


def _plain(name: str) -> str:
    return name.removesuffix("_C").replace("_C.", " ").replace("_", " ")
