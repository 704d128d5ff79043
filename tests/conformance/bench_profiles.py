"""Drivers of line scanners, which stream profiles while the arm moves, in front of fake sensors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.files import EXPOSURE
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, FakeGoPxLOptions
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.gopxl.driver import GoPxL

from mbcacq.conformance import Channel, Stand, TcpProxy, counted

RATE_HZ, BEGAN_S, PAUSE_S, SWEEP_S, RISE_MM_S = 100.0, 90.0, 0.1, 0.3, 10.0
KINDS = {"classic": (FakeGocator, FakeGocatorOptions, Gocator, "3210"), "GoPxL": (FakeGoPxL, FakeGoPxLOptions, GoPxL, "3504")}


class Rising:
    """A world whose clock the bench turns; a line that rises with it, so that its height says when it was seen."""

    def __init__(self) -> None:
        self.time_s = 100.0

    def now(self) -> float:
        return self.time_s

    def profiles(self, times: np.ndarray) -> list[np.ndarray]:
        x = np.linspace(-10, 10, 12)
        return [np.column_stack([x, np.full(12, RISE_MM_S * (t - 100) - 50)]) for t in times]


@contextmanager
def profiles(kind: str, **more: Any) -> Iterator[Stand]:
    """No profile of a sweep may have another moment's time, whatever happened to its message; one wrong bit may hurt the profile that it is
    in, which misses the others of its ball. A loss at either end of a sweep cannot be counted."""
    world = Rising()
    make_sensor, make_options, driver, model = KINDS[kind]

    def nothing(exposure_us: float) -> ScannerFrame:
        return ScannerFrame(np.zeros((1, 1, 3), np.float32))

    with ExitStack() as stack:
        about = make_options(profiles=True, frame_rate_hz=RATE_HZ, clock_began_s=BEGAN_S, model=model)
        sensor = stack.enter_context(make_sensor(nothing, about, line=world))
        proxies = {
            name: stack.enter_context(TcpProxy(Channel(name), ("127.0.0.1", port), cut=counted(), cut_driver=counted()))
            for name, port in sensor.ports._asdict().items()
        }
        ports = {f"{name}_port": proxy.port for name, proxy in proxies.items()}
        given = {"address": "127.0.0.1", **ports, "mode": "profile", **more}

        def use(scanner: Any) -> None:
            world.time_s += PAUSE_S
            scanner.start_profiles()
            try:
                world.time_s += SWEEP_S
            finally:
                scanner.end_profiles()
            found = scanner.profiles()
            heights = found.points[found.first, 1]
            wrong = np.abs(heights + 50 - RISE_MM_S * (found.time_s + BEGAN_S - 100)) > 0.02
            assert wrong.sum() <= 1, f"{wrong.sum()} of {len(found)} profiles have the time of another"
            assert 0 < len(found) + found.lost <= round(SWEEP_S * RATE_HZ) + 2, f"{len(found)} profiles, {found.lost} lost"

        def begin(scanner: Any) -> None:
            scanner.start_profiles()
            while len(scanner.profiles()) == 0:
                world.time_s += 1 / RATE_HZ
                time.sleep(0.01)

        def replaced(part: object, what: str, value: object) -> None:
            setattr(part, what, value)
            for proxy in proxies.values():
                proxy.cut()

        facts = {
            "classic": {
                "serial number": lambda: replaced(sensor.state, "options", replace(sensor.options, serial=54321)),
                "firmware": lambda: replaced(sensor.state, "firmware", (6, 1, 99, 0)),
                "job": lambda: setattr(sensor.files, "loaded_job", "other.job"),
                "exposure": lambda: sensor.files.set_number(EXPOSURE, 777.0),
            },
            "GoPxL": {
                "serial number": lambda: replaced(sensor.resources, "serial", "54321"),
                "firmware": lambda: replaced(sensor.resources, "api", "1.1.0"),
                "job": lambda: setattr(sensor.resources, "loaded_job", "other"),
                "alignment": lambda: setattr(sensor.resources, "align_state", 1),
                "exposure": lambda: sensor.resources.sensor["exposureSettings"].update(singleExposure=777.0),
            },
        }
        yield Stand(
            lambda **o: driver("line", model, {**given, **o}),
            use,
            proxies,
            lambda: driver("line", "2999", given),
            begin,
            short_limits={"timeout_s": 0.6, "reply_limit_s": 0.6, "connect_timeout_s": 1.0},
            facts=facts[kind],
        )
