"""The GoPxL driver in front of a fake sensor."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
from bench_gocator import VOLUME, check_scan, tilted_plane
from mbcacq_fakes.protocols.gopxl import FakeGoPxL
from mbcacq_fakes.protocols.gopxl.server import FakeGoPxLOptions
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.gopxl.driver import GoPxL

from mbcacq.conformance import Channel, Stand, TcpProxy, counted


@contextmanager
def gopxl(**more: Any) -> Iterator[Stand]:
    """Every scan is of another plane, so that an old one cannot pass for a new one."""
    plane, asked = tilted_plane(), []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return ScannerFrame(plane.xyz + np.float32([0, 0, 0.5 * len(asked)]), plane.intensity)

    with ExitStack() as stack:
        sensor = stack.enter_context(FakeGoPxL(source, FakeGoPxLOptions(volume=VOLUME)))
        proxies = {
            name: stack.enter_context(TcpProxy(Channel(name), ("127.0.0.1", port), cut=counted(), cut_driver=counted()))
            for name, port in sensor.ports._asdict().items()
        }
        ports = {f"{name}_port": proxy.port for name, proxy in proxies.items()}
        given = {"address": "127.0.0.1", **ports, **more}
        short_limits = {"timeout_s": 0.6, "reply_limit_s": 0.6, "connect_timeout_s": 1.0}

        def use(scanner: GoPxL) -> None:
            before = len(asked)
            scan = scanner.capture(900.0 + 10 * before)
            check_scan(scan, plane, range(before + 1, len(asked) + 1))

        def begin(scanner: GoPxL) -> None:
            sensor.faults.set("no_data", times=1)
            scanner.capture()

        def longer(exposure_us: float) -> ScannerFrame:
            sensor.resources.sensor["exposureSettings"]["singleExposure"] = 1.5 * exposure_us
            return source(exposure_us)

        def replaced(what: str, value: object) -> None:
            setattr(sensor.resources, what, value)
            for proxy in proxies.values():
                proxy.cut()

        yield Stand(
            lambda **o: GoPxL("scanner", "3504", {**given, **o}),
            use,
            proxies,
            lambda: GoPxL("scanner", "3210", given),
            begin,
            short_limits=short_limits,
            facts={
                "serial number": lambda: replaced("serial", "54321"),
                "firmware": lambda: replaced("api", "1.1.0"),
                "job": lambda: setattr(sensor.resources, "loaded_job", "other"),
                "alignment": lambda: sensor.resources.transform.update(x=2.5),
                "exposure": lambda: setattr(sensor, "source", longer),
            },
        )
