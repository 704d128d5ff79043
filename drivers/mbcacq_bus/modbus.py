"""Positioner and sensor behind Modbus registers that the plan describes."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Any

from pydantic import Field as Option
from pydantic import model_validator

from mbcacq.devices import ConfigError, ContextDevice, Description, DeviceFault, Fact, Field, parse_options
from mbcacq_bus.idle import IdlePoll
from mbcacq_bus.modbus_connection import Connection
from mbcacq_bus.modbus_link import ModbusLink
from mbcacq_bus.plausible import Plausibility
from mbcacq_bus.registers import Register
from mbcacq_bus.stations import StationOptions, StationPositioner


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


class ModbusPositioner(StationPositioner):
    """Moves the artefact by writing a position and waiting for the controller's flag."""

    options_model = PositionerOptions

    first_contact = (
        "Before anything is written: the registers of identity and position read what the device's own display shows.",
        "With the drive's enabling taken away, a target is written and refused: the sentence names the fault.",
        "One station after another at reduced speed: the position that is read is where the stand is.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        o = self._options = parse_options(PositionerOptions, "the Modbus positioner", options)
        link = ModbusLink(f"positioner {model}".strip(), o)
        super().__init__(model, o, link, lambda: link.read(o.in_position), o.position.unit, o.flag_delay_s, threading.Event())

    def _begin(self, station: str, target: float) -> None:
        o = self._options
        self._refuse_fault(f"before it goes to station {station}")
        if o.ready is not None and not self._link.read(o.ready):
            raise DeviceFault(f"the positioner is not ready to go to station {station}; switch its drive on and reference it")
        try:
            self._link.write(o.position, target)
        except ValueError as error:
            raise ConfigError(f"position of station {station}: {error}; correct the positioner's stations") from error
        if o.start is not None:
            self._link.write(o.start, 1)

    def _fault(self) -> str:
        code = 0.0 if self._options.fault is None else self._link.read(self._options.fault)
        return f"{code:g}" if code else ""

    def _says_arrived(self) -> bool:
        return bool(self._link.read(self._options.in_position))

    def _position(self) -> float | None:
        return None if self._options.actual is None else self._link.read(self._options.actual)

    def _halt(self) -> None:
        self._link.write(self._options.halt, 1, urgent=True)


class ModbusSensor(ContextDevice):
    """Reads named values, e.g. temperatures, from registers."""

    options_model = SensorOptions

    first_contact = ("The values that `mbcacq doctor {plan}` reads are those on the device's display, in the units of the plan.",)

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._options = parse_options(SensorOptions, "the Modbus sensor", options)
        o, registers = self._options, self._options.values
        self._device, first = f"sensor {model}".strip(), next(iter(registers.values()))
        link = self._link = ModbusLink(self._device, o)
        self._idle = IdlePoll(lambda: link.read(first), lambda: link.used, o.idle_poll_s if o.has_connection else 0.0)
        rates = {name: r.max_rate for name, r in registers.items() if r.max_rate is not None}
        self._plausible = Plausibility({name: r.unit for name, r in registers.items()}, rates)
        self._model = model

    def connect(self) -> None:
        self._link.open()
        self._idle.start()

    def stop(self) -> None:
        pass

    def close(self) -> None:
        self._idle.stop()
        self._link.close()

    def describe(self) -> Description:
        return Description("sensor", self._model, tuple(Field(k, r.unit) for k, r in self._options.values.items()))

    def read(self) -> dict[str, float]:
        """Values by name. Raises DeviceTimeout, DeviceFault (also where they cannot follow the last ones, read twice)."""
        return self._plausible.checked(self._device, self._read_all(), self._read_again, time.monotonic)

    def facts(self) -> tuple[Fact, ...]:
        """A reading that was doubted and read again."""
        return self._plausible.facts()

    def _read_again(self, doubted: bool) -> dict[str, float]:
        if doubted:
            self._link.keep_in_step()
        return self._read_all()

    def _read_all(self) -> dict[str, float]:
        values = {name: self._link.read(register) for name, register in self._options.values.items()}
        for name, value in values.items():
            low, high = self._options.values[name].valid or (-math.inf, math.inf)
            if not math.isfinite(value) or not low <= value <= high:
                raise DeviceFault(f"{self._device} reports {value:g} for {name}; is its probe connected?")
        return values
