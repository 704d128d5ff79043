"""The OPC UA driver in front of asyncua's server, which is started once: an address space takes a second to build."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from mbcacq_fakes.protocols.opcua import FakeOpcUaServer
from mbcacq_opcua.driver import OpcUaRobot

from mbcacq.conformance import Channel, Stand, TcpProxy, counted

HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
MESSAGE = counted(at=4, size=4)  # OPC UA's message header: type, then the size of the whole


@cache
def server() -> FakeOpcUaServer:
    return FakeOpcUaServer(start_deg=HOME_DEG).start()


@contextmanager
def opcua() -> Iterator[Stand]:
    fake = server()
    with TcpProxy(Channel("opcua"), ("127.0.0.1", fake.port), cut=MESSAGE, cut_driver=MESSAGE) as proxy:
        made: list[OpcUaRobot] = []

        def make(**more: Any) -> OpcUaRobot:
            options = {"address": "127.0.0.1", "port": proxy.port, "limits_deg": [[-360, 360]] * 6, "rate_hz": 50.0, **more}
            made.append(OpcUaRobot("arm", "KR 10", options))
            return made[-1]

        def use(robot: OpcUaRobot) -> None:
            target = np.radians(HOME_DEG if np.abs(np.degrees(fake.q) - HOME_DEG).max() > 0.5 else HOME_DEG + 2)
            fake.lead(target)
            while np.abs(robot.state().q - target).max() > 1e-9:
                time.sleep(0.005)

        yield Stand(
            make,
            use,
            {"opcua": proxy},
            wrong=lambda: make(expect_model="M-10iD"),
            facts={
                "payload": lambda: fake.report(Mass=9.0),
                "Model": lambda: fake.report(Model="KR 300 R2700"),
                "SerialNumber": lambda: fake.report(SerialNumber="4712"),
            },
            short_limits={"silence_s": 0.5, "connect_timeout_s": 1.0},
        )
        for robot in made:
            robot.close()
        fake.report(Mass=2.3, Model="KR 10 R1100-2", SerialNumber="4711")
