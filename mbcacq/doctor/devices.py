"""Every device of a plan, connected and identified, all at once. Nothing is moved; what listens is closed again."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import cast

from mbcacq.acquisition.cell_devices import create_devices
from mbcacq.acquisition.device_check import device_findings
from mbcacq.devices import ConfigError, Device, MbcacqError, Sensor
from mbcacq.devices.addresses import on_loopback_only
from mbcacq.doctor.line import CheckupLine, from_error
from mbcacq.plan import LoadedPlan


def lines(loaded: LoadedPlan, arm: bool) -> Iterator[CheckupLine]:
    impossible = [from_error("devices", ConfigError(str(found))) for found in device_findings(loaded)]
    if impossible:
        yield from impossible
        return
    devices = create_devices(loaded).all
    followed = loaded.plan.robot.follow is not None  # nothing of such an arm is switched on
    if not arm and not followed and not on_loopback_only(loaded.plan.robot.options):
        del devices["robot"]
        yield CheckupLine(
            "warning",
            "robot",
            "not asked: connecting it could switch its drives on",
            "mbcacq doctor PLAN --arm asks it too; it is not moved",
        )
    if not devices:
        return
    with ThreadPoolExecutor(len(devices)) as pool:
        yield from pool.map(_ask, devices, devices.values())


def _ask(role: str, device: Device) -> CheckupLine:
    try:
        with device:
            about = device.describe()
            text = " ".join(part for part in (about.model or about.kind, about.serial, about.firmware) if part)
            if role.startswith("sensor"):
                units = {field.name: field.unit for field in about.fields}
                read = ", ".join(f"{name} {value:g} {units.get(name, '')}".rstrip() for name, value in cast(Sensor, device).read().items())
                text = f"{text}: {read}"
            return CheckupLine("ok", role, text)
    except MbcacqError as error:
        line = from_error(role, error)
        nobody = isinstance(error, ConfigError) and getattr(device, "asks", False)
        return replace(line, level="warning") if nobody else line  # doctor itself may well run without a terminal
    except Exception as error:
        return CheckupLine("error", role, f"unexpected {type(error).__name__}: {error}", "report it: a driver must name what is wrong")
