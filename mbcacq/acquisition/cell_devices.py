"""The devices of a plan: created, connected all at once, closed all together."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.devices import ConnectError, Device, Positioner, Robot, Scanner, Sensor, create
from mbcacq.plan import LoadedPlan

Overrides = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class CellDevices:
    robot: Robot
    scanner: Scanner
    positioner: Positioner
    sensors: tuple[Sensor, ...] = ()

    @property
    def all(self) -> dict[str, Device]:
        named = {"robot": self.robot, "scanner": self.scanner, "positioner": self.positioner}
        return named | {f"sensor {i + 1}": s for i, s in enumerate(self.sensors)}

    def connect(self) -> None:
        """Connect every device at the same time. Raises ConnectError that names every device that failed, not only the first."""
        failures: dict[str, Exception] = {}
        devices = self.all
        with ThreadPoolExecutor(len(devices)) as pool:
            try:
                for name, future in {n: pool.submit(d.connect) for n, d in devices.items()}.items():
                    try:
                        future.result()
                    except Exception as error:
                        failures[name] = error
            except BaseException:  # Ctrl-C: closing ends the wait of those that still connect
                self.close()
                raise
        if not failures:
            return
        self.close()
        if len(failures) == 1:
            raise next(iter(failures.values()))
        raise ConnectError("; ".join(str(error) if str(error).startswith(name) else f"{name}: {error}" for name, error in failures.items()))

    def close(self) -> None:
        """Stop and release everything, the robot first; every device is closed even if another one fails to."""
        with ExitStack() as stack:
            for device in reversed(self.all.values()):
                stack.callback(device.close)
            for device in self.all.values():
                device.stop()


def create_devices(loaded: LoadedPlan, overrides: Overrides | None = None) -> CellDevices:
    """Construct the drivers a plan names; nothing is opened. ``overrides`` (by 'robot', 'scanner', 'positioner') win over the plan."""
    overrides = overrides or {}
    plan, robot = loaded.plan, loaded.cell.robot

    def device(kind: str, role: str, driver: str, model: str, options: Mapping[str, Any]) -> Any:
        return create(kind, driver, model, {**options, **overrides.get(role, {})})

    limits = {"limits_deg": np.degrees(robot.limits).tolist()}
    if robot.speed is not None:
        limits["speed_deg_s"] = np.degrees(robot.speed).tolist()
    return CellDevices(
        robot=device("robots", "robot", plan.robot.driver, robot.name, {**limits, **plan.robot.options}),
        scanner=device("scanners", "scanner", plan.scanner.driver, plan.scanner.model, plan.scanner.options),
        positioner=device("positioners", "positioner", plan.positioner.driver, plan.positioner.model, plan.positioner.options),
        sensors=tuple(device("sensors", f"sensor {i + 1}", s.driver, s.model, s.options) for i, s in enumerate(plan.sensors)),
    )
