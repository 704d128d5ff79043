"""Positioner and sensor behind Modbus registers that the plan describes."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Any

from pydantic import Field as Option
from pydantic import model_validator

from mbcacq.devices import Aborted, ConfigError, ContextDevice, Description, DeviceFault, DeviceTimeout, Fact, Field, parse_options
from mbcacq_bus.idle import IdlePoll
from mbcacq_bus.modbus_connection import Connection
from mbcacq_bus.modbus_link import ModbusLink
from mbcacq_bus.options import StationOptions
from mbcacq_bus.plausible import Plausibility
from mbcacq_bus.registers import Register

POLL_S = 0.02


class PositionerOptions(StationOptions, Connection):
    """Arrival: ``in_position`` is set, and ``actual`` (where there is one) is near the position commanded.

    A controller lowers its flag only some time after a command: without ``actual``, the flag is believed after ``flag_delay_s``.
    ready: must be set before a command is sent (drives on, referenced).
    """

    position: Register
    in_position: Register
    actual: Register | None = None
    start: Register | None = None
    ready: Register | None = None
    fault: Register | None = None
    halt: Register | None = None
    flag_delay_s: float = Option(default=0.2, ge=0)

    @model_validator(mode="after")
    def _writable(self) -> PositionerOptions:
        for name in ("position", "start", "halt"):
            register = getattr(self, name)
            if register is not None and register.table not in ("holding", "coil"):
                raise ValueError(f"{name} must be a holding register or a coil, a {register.table} cannot be written")
        self.refuse_outside()
        return self


class SensorOptions(Connection):
    values: dict[str, Register] = Option(min_length=1)


class _ModbusDevice(ContextDevice):
    """Connection life cycle, common to both kinds. harmless: what is read to keep an idle connection alive."""

    def __init__(self, device: str, options: Connection, harmless: Register) -> None:
        self._device, self._link = device, ModbusLink(device, options)
        after_s = options.idle_poll_s if options.has_connection else 0.0
        self._idle = IdlePoll(lambda: self._link.read(harmless), lambda: self._link.used, after_s)

    def connect(self) -> None:
        self._link.open()
        self._idle.start()

    def stop(self) -> None:
        pass

    def close(self) -> None:
        self._idle.stop()
        self.stop()
        self._link.close()


class ModbusPositioner(_ModbusDevice):
    """Moves the artefact by writing a position and waiting for the controller's flag."""

    options_model = PositionerOptions

    first_contact = (
        "Before anything is written: the registers of identity and position read what the device's own display shows.",
        "With the drive's enabling taken away, a target is written and refused: the sentence names the fault.",
        "One station after another at reduced speed: the position that is read is where the stand is.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._options = parse_options(PositionerOptions, "the Modbus positioner", options)
        super().__init__(f"positioner {model}".strip(), self._options, self._options.in_position)
        self._targets = {str(k): v for k, v in self._options.stations.items()}
        self._model, self._stopped = model, threading.Event()

    def describe(self) -> Description:
        unit = self._options.position.unit
        return Description("positioner", self._model, (Field("position", unit, meaning="commanded position of the artefact"),))

    def connect(self) -> None:
        self._stopped.clear()
        super().connect()

    def go_to(self, station: str, prompt: str) -> None:
        """Raises ConfigError for an unknown station, DeviceTimeout, DeviceFault, Aborted after ``stop``."""
        if station not in self._targets:
            raise ConfigError(f"the plan gives no position for station {station}; add it to the positioner's stations")
        target = self._targets[station]
        self._stopped.clear()
        try:
            self._go_to(station, target)
        except DeviceTimeout as error:
            if not self._stopped.is_set():
                raise
            raise Aborted(f"stopped on the way to station {station}") from error  # a request gave way to the one that stops

    def _go_to(self, station: str, target: float) -> None:
        o = self._options
        self._refuse_unready(station)
        try:
            self._link.write(o.position, target)
        except ValueError as error:
            raise ConfigError(f"position of station {station}: {error}; correct the positioner's stations") from error
        if o.start is not None:
            self._link.write(o.start, 1)
        self._wait(station, target)
        if self._stopped.wait(o.settle_s):
            raise Aborted(f"stopped on the way to station {station}")

    def stop(self) -> None:
        """Also writes the ``halt`` register where the plan names one."""
        self._stopped.set()
        if self._options.halt is not None and self._link.connected:
            try:
                self._link.write(self._options.halt, 1, urgent=True)
            except Exception:  # stop never raises; the positioner's own watchdog is the last line
                return

    def _refuse_unready(self, station: str) -> None:
        o = self._options
        if o.fault is not None and (code := self._link.read(o.fault)):
            raise DeviceFault(f"the positioner reports fault {code:g} before it goes to station {station}; clear it at its controller")
        if o.ready is not None and not self._link.read(o.ready):
            raise DeviceFault(f"the positioner is not ready to go to station {station}; switch its drive on and reference it")

    def _wait(self, station: str, target: float) -> None:
        o, began = self._options, time.monotonic()
        where = "in an unknown place"
        while True:
            if self._stopped.is_set():
                raise Aborted(f"stopped on the way to station {station}")
            if o.fault is not None and (code := self._link.read(o.fault)):
                raise DeviceFault(f"the positioner reports fault {code:g} on the way to station {station}; clear it at its controller")
            elapsed = time.monotonic() - began
            flag = bool(self._link.read(o.in_position)) and (o.actual is not None or elapsed >= o.flag_delay_s)
            if o.actual is not None:
                actual = self._link.read(o.actual)
                where = f"at {actual:g} {o.actual.unit}".rstrip()
                flag = flag and abs(actual - target) <= o.tolerance
            if flag:
                return
            if elapsed > o.move_timeout_s:
                raise DeviceTimeout(
                    f"the positioner did not reach station {station} ({target:g}) within {o.move_timeout_s:g} s: "
                    f"it is {where}; see what holds it"
                )
            self._stopped.wait(POLL_S)


class ModbusSensor(_ModbusDevice):
    """Reads named values, e.g. temperatures, from registers."""

    options_model = SensorOptions

    first_contact = ("The values that `mbcacq doctor {plan}` reads are those on the device's display, in the units of the plan.",)

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._options = parse_options(SensorOptions, "the Modbus sensor", options)
        registers = self._options.values
        super().__init__(f"sensor {model}".strip(), self._options, next(iter(registers.values())))
        rates = {name: r.max_rate for name, r in registers.items() if r.max_rate is not None}
        self._plausible = Plausibility({name: r.unit for name, r in registers.items()}, rates)
        self._model = model

    def describe(self) -> Description:
        return Description("sensor", self._model, tuple(Field(k, r.unit) for k, r in self._options.values.items()))

    def read(self) -> dict[str, float]:
        """Values by name. Raises DeviceTimeout, DeviceFault (also where they cannot follow the last ones, read twice)."""
        return self._plausible.checked(self._device, self._read_all(), self._read_again, time.monotonic)

    def facts(self) -> tuple[Fact, ...]:
        """A reading that was doubted and read again."""
        return self._plausible.facts()

    def _read_again(self) -> dict[str, float]:
        self._link.keep_in_step()
        return self._read_all()

    def _read_all(self) -> dict[str, float]:
        values = {name: self._link.read(register) for name, register in self._options.values.items()}
        for name, value in values.items():
            low, high = self._options.values[name].valid or (-math.inf, math.inf)
            if not math.isfinite(value) or not low <= value <= high:
                raise DeviceFault(f"{self._device} reports {value:g} for {name}; is its probe connected?")
        return values
