"""Whether the drivers that a plan names exist and take the options that it gives them: asked of the drivers, before anything is opened."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from mbcacq.acquisition.cell_devices import device_makers, hand_on_outputs, refuse_equal_names
from mbcacq.devices import ConfigError, Sensor
from mbcacq.plan import LoadedPlan
from mbcacq.plan.findings import PlanFinding


def device_findings(loaded: LoadedPlan) -> Iterator[PlanFinding]:
    """An error for every device of the plan that its driver refuses, or that has no driver, with the line of the option in question."""
    sensors: list[Sensor] = []
    made: dict[str, Any] = {}
    for role, make in device_makers(loaded).items():
        try:
            device = make()
        except ConfigError as error:
            yield _finding(loaded, role, str(error))
            continue
        made[role] = device
        if role.startswith("sensor"):
            sensors.append(device)
    if "robot" in made and "scanner" in made:
        try:
            hand_on_outputs(made["robot"], made["scanner"])
        except ConfigError as error:
            yield _finding(loaded, "scanner", str(error))
    try:
        refuse_equal_names(sensors)
    except ConfigError as error:
        yield _finding(loaded, "sensors", str(error))


def refuse_impossible_devices(loaded: LoadedPlan) -> None:
    """Raises ConfigError with file and line for the first device of the plan that cannot be."""
    for found in device_findings(loaded):
        raise ConfigError(str(found))


def refuse_unattended(loaded: LoadedPlan, assume_yes: bool = False) -> None:
    """Raises ConfigError if a device must ask a person who is not there (``refuse_unattended`` of its driver says so): before the arm is
    allowed to move, and before anything is opened. assume_yes: a person who moves the artefacts is not asked."""
    for role, make in device_makers(loaded).items():
        if role == "positioner" and assume_yes:
            continue
        if (refuse := getattr(make(), "refuse_unattended", None)) is not None:
            refuse()


def _finding(loaded: LoadedPlan, role: str, sentence: str) -> PlanFinding:
    section: tuple[str | int, ...] = ("sensors", int(role.split()[1]) - 1) if role.startswith("sensor ") else (role,)
    keys = [where for where in loaded.lines if where[: len(section)] == section]
    fault = sentence.partition(" (it knows:")[0]  # of which the other options are no part
    options = [where for where in keys if "options" in where and re.search(rf"\b{re.escape(str(where[-1]))}\b", fault)]
    driver = (*section, "driver")
    at = max(options, key=len) if options else driver if driver in loaded.lines else section
    return PlanFinding(level="error", code="device", step="", place=f"{loaded.path}:{loaded.lines.get(at, 1)}", sentence=sentence)
