"""Positioners that are sent to a position of their own: what is alike on every bus."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from pydantic import Field as Option

from mbcacq.devices import Aborted, ConfigError, ContextDevice, Description, DeviceFault, DeviceTimeout, DriverOptions, Fact, Field
from mbcacq_bus.idle import IdlePoll


class StationOptions(DriverOptions):
    """stations: station id -> position. limits: of the position; a station outside is refused."""

    stations: dict[str | int, float] = Option(min_length=1)
    limits: tuple[float, float] | None = None
    tolerance: float = Option(default=0.05, gt=0)
    move_timeout_s: float = Option(default=120.0, gt=0)
    settle_s: float = Option(default=0.0, ge=0)

    def refuse_outside(self, unit: str = "") -> None:
        """Raises ValueError for a station beyond the limits."""
        for station, value in self.stations.items():
            if self.limits is not None and not self.limits[0] <= value <= self.limits[1]:
                low, high = self.limits
                raise ValueError(f"station {station} at {value:g}{unit} is outside the limits {low:g}..{high:g}")


class StationPositioner(ContextDevice, ABC):
    """Commands a position and looks until the artefact is there: the device says so, and its position, where it reports one, is near.

    Parameters
    ----------
    model : str
        Of the plan.
    options : Any
        A StationOptions with the connection's ``idle_poll_s``.
    link : Any
        The connection: ``open``, ``close``, ``connected``, ``used`` and ``name``.
    harmless : Callable[[], object]
        A question that keeps an idle connection alive.
    unit : str
        Of the positions.
    flag_delay_s : float
        A device lowers its flag only some time after a command: where it reports no position, the flag is believed after so long.
    """

    poll_s = 0.02

    def __init__(
        self, model: str, options: Any, link: Any, harmless: Callable[[], object], unit: str, flag_delay_s: float, stopped: threading.Event
    ) -> None:
        self._model, self._options, self._link, self._unit, self._flag_delay_s = model, options, link, unit, flag_delay_s
        self._idle = IdlePoll(lambda: self._look_after(harmless), lambda: link.used, options.idle_poll_s)
        self._targets = {str(k): v for k, v in options.stations.items()}
        self._stopped = stopped
        self._standing_at: float | None = None  # the position where it should stand now
        self._facts: tuple[Fact, ...] = ()

    @abstractmethod
    def _begin(self, station: str, target: float) -> None:
        """Command the position."""

    @abstractmethod
    def _fault(self) -> str:
        """The fault that the device reports, '' for none."""

    @abstractmethod
    def _says_arrived(self) -> bool:
        """Whether its flag is set; True where it has none."""

    @abstractmethod
    def _position(self) -> float | None:
        """Where it is, None where it does not report that."""

    @abstractmethod
    def _halt(self) -> None:
        """Stop the motion; called where the plan has the option halt."""

    def connect(self) -> None:
        """Raises ConnectError, IdentityError."""
        self._stopped.clear()
        self._link.open()
        self._idle.start()

    def describe(self) -> Description:
        return Description("positioner", self._model, (Field("position", self._unit, meaning="commanded position of the artefact"),))

    def facts(self) -> tuple[Fact, ...]:
        """Whether it still stands where it was sent, as it says whenever its connection was idle for a while."""
        return self._facts

    def _look_after(self, harmless: Callable[[], object]) -> None:
        if (target := self._standing_at) is None:
            harmless()
            return
        stands = self._says_arrived() and ((position := self._position()) is None or abs(position - target) <= self._options.tolerance)
        if self._standing_at is target:  # it was not sent elsewhere meanwhile
            self._facts = (Fact("in position", "yes" if stands else "no"),)

    def go_to(self, station: str, prompt: str) -> None:
        """Raises ConfigError for an unknown station, DeviceTimeout, DeviceFault, ProtocolError, Aborted after ``stop``."""
        if station not in self._targets:
            raise ConfigError(f"the plan gives no position for station {station}; add it to the positioner's stations")
        self._stopped.clear()
        self._standing_at = None
        try:
            self._begin(station, self._targets[station])
            self._wait(station, self._targets[station])
        except DeviceTimeout as error:
            if not self._stopped.is_set():
                raise
            raise Aborted(f"stopped on the way to station {station}") from error  # a request gave way to the one that stops
        if self._stopped.wait(self._options.settle_s):
            raise Aborted(f"stopped on the way to station {station}")
        self._standing_at, self._facts = self._targets[station], (Fact("in position", "yes"),)

    def stop(self) -> None:
        """Also halts the motion where the plan says how."""
        self._stopped.set()
        if self._options.halt is not None and self._link.connected:
            with suppress(Exception):  # stop never raises; the positioner's own watchdog is the last line
                self._halt()

    def close(self) -> None:
        self._idle.stop()
        self.stop()
        self._link.close()

    def _refuse_fault(self, when: str) -> None:
        if code := self._fault():
            raise DeviceFault(f"{self._link.name} reports fault {code} {when}; clear it at its controller")

    def _wait(self, station: str, target: float) -> None:
        o, began, where = self._options, time.monotonic(), "in an unknown place"
        while not self._stopped.is_set():
            self._refuse_fault(f"on the way to station {station}")
            elapsed, arrived, position = time.monotonic() - began, self._says_arrived(), self._position()
            if position is None:
                arrived = arrived and elapsed >= self._flag_delay_s
            else:
                where = f"at {position:g} {self._unit}".rstrip()
                arrived = arrived and abs(position - target) <= o.tolerance
            if arrived:
                return
            if elapsed > o.move_timeout_s:
                raise DeviceTimeout(
                    f"{self._link.name} did not reach station {station} ({f'{target:g} {self._unit}'.rstrip()}) within "
                    f"{o.move_timeout_s:g} s: it is {where}; see what holds it"
                )
            self._stopped.wait(self.poll_s)
        raise Aborted(f"stopped on the way to station {station}")
