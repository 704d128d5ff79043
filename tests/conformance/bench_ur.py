"""The UR driver in front of a fake controller."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from mbcacq_fakes.protocols.rtde import FakeUrController
from mbcacq_ur.driver import UrRtdeRobot

from mbcacq.conformance import Channel, Stand, TcpProxy
from mbcacq.devices import MotionLimits

NO_IDENTITY = {"refuses_the_wrong_device": "RTDE does not say which model of arm answers"}
HOME_DEG = np.array([0.0, -90, 90, -90, -90, 0])
LIMITS = MotionLimits(*(np.radians(np.full(6, v)) for v in (60.0, 200.0, 2000.0)), settle_s=0.05)
ALL_ROUND = [[-360, 360]] * 6


@contextmanager
def ur_rtde() -> Iterator[Stand]:
    with FakeUrController(start_deg=HOME_DEG) as fake, TcpProxy(Channel("rtde"), ("127.0.0.1", fake.port)) as proxy:
        made: list[UrRtdeRobot] = []

        def make(**more: Any) -> UrRtdeRobot:
            options = {"address": "127.0.0.1", "port": proxy.port, "limits_deg": ALL_ROUND, "silence_s": 15.0, **more}
            made.append(UrRtdeRobot("arm", "UR10e", options))
            return made[-1]

        def use(robot: UrRtdeRobot) -> None:
            target = np.radians(HOME_DEG if np.abs(np.degrees(robot.state().q) - HOME_DEG).max() > 0.5 else HOME_DEG + 2)
            robot.move_to(target, LIMITS)
            while not robot.state().arrived:
                time.sleep(0.002)  # proxy and fake run in this process too
            assert np.abs(fake.arm.q - target).max() < 2e-4, "arrived, but the arm is elsewhere"

        yield Stand(
            make,
            use,
            {"rtde": proxy},
            begin=lambda robot: robot.move_to(np.radians(HOME_DEG + 170), LIMITS),
            at_rest=lambda: not fake.arm.moving,
            short_limits={"silence_s": 0.5, "connect_timeout_s": 1.0},
            output=(3, lambda: bool(fake.outputs >> 3 & 1)),
            facts={
                "payload": lambda: fake.inject(payload=7.0),
                "payload centre": lambda: fake.inject(payload_cog=(0.0, 0.0, 0.15)),
                "speed slider": lambda: fake.inject(speed_fraction=0.5),
                "safety": lambda: fake.inject(safety_bits=3),
            },
        )
        for robot in made:
            robot.close()
