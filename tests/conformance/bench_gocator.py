"""The Gocator driver in front of a fake sensor."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.files import EXPOSURE
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.driver import Gocator

from mbcacq.conformance import Channel, Stand, TcpProxy, counted
from mbcacq.devices import Scan

VOLUME = np.array([-20.0, -20, 150]), np.array([20.0, 20, 300])


def tilted_plane() -> ScannerFrame:
    y, x = np.mgrid[:12, :20].astype(np.float32)
    xyz = np.stack([x * 0.5 - 4, y * 0.5 - 3, 200 + 0.1 * x - 0.05 * y], axis=2)
    xyz[3:6, 7:11] = np.nan
    return ScannerFrame(xyz, (10 * y + x).astype(np.uint8))


def check_scan(scan: Scan, plane: ScannerFrame, numbers: range) -> None:
    """It is one of these exposures. One bit of a cloud is one point, which the fit of a sphere leaves out."""
    assert abs(len(scan.points) - 228) <= 1, f"{len(scan.points)} points instead of 228"
    away = (scan.points - plane.xyz.reshape(-1, 3)[scan.pixel].astype(float)) / [1, 1, 0.5]
    of_these = [number for number in numbers if np.sort(np.abs(np.nan_to_num(away, nan=1e9) - [0, 0, number]).max(axis=1))[-2] < 0.01]
    assert of_these, f"the points are those of no exposure of {numbers}"


@contextmanager
def gocator(**more: Any) -> Iterator[Stand]:
    """Every scan is of another plane, so that an old one cannot pass for a new one."""
    plane, asked = tilted_plane(), []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return ScannerFrame(plane.xyz + np.float32([0, 0, 0.5 * len(asked)]), plane.intensity)

    with ExitStack() as stack:
        sensor = stack.enter_context(FakeGocator(source, FakeGocatorOptions(health_period_s=0.1, volume=VOLUME)))
        proxies = {
            name: stack.enter_context(TcpProxy(Channel(name), ("127.0.0.1", port), cut=counted(), cut_driver=counted()))
            for name, port in sensor.ports._asdict().items()
        }
        ports = {f"{name}_port": proxy.port for name, proxy in proxies.items()}
        given = {"address": "127.0.0.1", **ports, **more}
        short_limits = {"timeout_s": 0.6, "reply_limit_s": 0.6, "connect_timeout_s": 1.0}

        def use(scanner: Gocator) -> None:
            before = len(asked)
            scan = scanner.capture(900.0 + 10 * before)
            check_scan(scan, plane, range(before + 1, len(asked) + 1))

        def begin(scanner: Gocator) -> None:
            sensor.faults.set("no_data", times=1)
            scanner.capture()

        number = sensor.files.number

        def longer(path: str) -> float:
            return number(path) * (1.5 if path == EXPOSURE else 1.0)

        def replaced(what: str, value: object) -> None:
            setattr(sensor.state, what, value)
            for proxy in proxies.values():
                proxy.cut()

        yield Stand(
            lambda **o: Gocator("front", "3210", {**given, **o}),
            use,
            proxies,
            lambda: Gocator("front", "3504", given),
            begin,
            short_limits=short_limits,
            facts={
                "serial number": lambda: replaced("options", replace(sensor.options, serial=54321)),
                "firmware": lambda: replaced("firmware", (6, 1, 99, 0)),
                "job": lambda: setattr(sensor.files, "loaded_job", "other.job"),
                "exposure": lambda: setattr(sensor.files, "number", longer),
            },
        )
