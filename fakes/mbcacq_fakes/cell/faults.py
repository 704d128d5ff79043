"""Faults injected into a fake cell while it runs."""

from __future__ import annotations

from typing import Any, Protocol


class FaultTarget(Protocol):
    """Where faults are injected: the cell's controller (``krc``), and what its process is asked to do."""

    krc: Any

    def ask(self, command: str, **arguments: Any) -> Any: ...


class CellFaults:
    """What can be done to the cell while it runs."""

    def __init__(self, cell: FaultTarget) -> None:
        self._cell = cell

    def robot(self, **faults: float) -> None:
        """See mbcacq_fakes.protocols.krc.settings.FAULTS, or for an EKI controller mbcacq_fakes.protocols.krc.eki_settings.FAULTS."""
        self._cell.krc.inject(**faults)

    def scanner(self, fault: str, value: Any = True, times: int | None = None) -> None:
        """See mbcacq_fakes.protocols.gocator.FAULTS."""
        self._cell.ask("scanner_fault", fault=fault, value=value, times=times)

    def clear_scanner(self, fault: str | None = None) -> None:
        self._cell.ask("clear_scanner_fault", fault=fault)

    def positioner(self, **values: Any) -> None:
        """Set ``stuck`` (bool), ``fault`` (code) or ``silent`` (bool) of a Modbus positioner."""
        self._cell.ask("positioner_fault", **values)

    def sensor(self, number: int, **values: Any) -> None:
        """Set ``silent`` (bool) of a sensor that the cell plays, counted from 0 in the plan's order."""
        self._cell.ask("sensor_fault", number=number, **values)

    def mishap(self, kind: str, **details: Any) -> None:
        """wrong_artefact (station, artefact), hidden_ball (ball), bumped_tripod (station, shift_mm, rotation_deg), empty_scene."""
        self._cell.ask("mishap", kind=kind, **details)
