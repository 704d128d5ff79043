"""Options of the folder driver, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field as Option
from pydantic import model_validator

from mbcacq.devices import DriverOptions


class TriggerOptions(DriverOptions):
    """How the scanner's program is asked for a cloud; one of these.

    person: somebody takes it. command: a program and its arguments, run without a shell. tcp: HOST:PORT to send to. serial: a port,
    also socket://HOST:PORT. output: a digital output of the robot, on for pulse_s, where its driver can switch outputs. send: the text
    for tcp and serial. reply: a pattern of the line that acknowledges it, or None for none.
    """

    person: Literal[True] | None = None
    command: tuple[str, ...] | None = Option(default=None, min_length=1)
    tcp: str | None = Option(default=None, pattern=r"^[^\s:]+:\d{1,5}$")
    serial: str | None = None
    output: int | None = Option(default=None, ge=0)
    pulse_s: float = Option(default=0.2, gt=0, le=10)
    baudrate: int = Option(default=9600, gt=0)
    send: str = "trigger\n"
    reply: str | None = None

    @model_validator(mode="after")
    def _one(self) -> TriggerOptions:
        given = [name for name in ("person", "command", "tcp", "serial", "output") if getattr(self, name) not in (None, (), "")]
        if len(given) != 1:
            raise ValueError(f"give one of person, command, tcp, serial and output, not {' and '.join(given) or 'none'}")
        return self


class FolderOptions(DriverOptions):
    """folder: where the clouds are saved, relative to where the run is started. pattern: of their names. timeout_s: how long a cloud may
    take from its trigger on. quiet_s: how long a file must not grow any more to count as written. unit, axes, range_map: how the clouds are
    written. watched: files in which the scanner's program keeps settings, job or calibration; poses before and after a change of one are
    kept apart. read_cloud: set by the run; reads a file."""

    folder: Path
    pattern: str = "*"
    trigger: TriggerOptions = TriggerOptions(person=True)
    timeout_s: float = Option(default=120.0, gt=0)
    quiet_s: float = Option(default=0.5, ge=0)
    connect_timeout_s: float = Option(default=5.0, gt=0)
    unit: str | None = None
    axes: str = "x y z"
    range_map: tuple[float, float, float, float] | None = None
    watched: tuple[Path, ...] = ()
    read_cloud: Any = None
