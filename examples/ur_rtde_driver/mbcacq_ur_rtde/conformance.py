"""The driver held to the suite that every driver must pass, against the package's own fake: ``python -m mbcacq_ur_rtde.conformance``."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from mbcacq.conformance import Channel, DriverBench, Stand, TcpProxy, run
from mbcacq.devices import MotionLimits
from mbcacq_ur_rtde.driver import UrRtde
from mbcacq_ur_rtde.fake import FakeUr

HOME_DEG = np.array([0.0, -90, 90, -90, -90, 0])
LIMITS = MotionLimits(*(np.radians(np.full(6, v)) for v in (60.0, 200.0, 2000.0)), settle_s=0.05)
EXCUSED = {
    "refuses_the_wrong_device": "RTDE does not say which model of arm answers",
    "an_output_that_is_on_goes_off": "it switches no outputs",
    "a_changed_fact_is_seen": "it declares no facts",
}


def length(data: bytes) -> int:
    """Where the first package of these bytes ends, 0: not yet."""
    return int.from_bytes(data[:2], "big") if len(data) >= 2 and len(data) >= int.from_bytes(data[:2], "big") else 0


@contextmanager
def opened() -> Iterator[Stand]:
    """The driver behind a proxy in front of the fake."""
    with FakeUr(start_deg=HOME_DEG) as fake, TcpProxy(Channel("rtde"), ("127.0.0.1", fake.port)) as proxy:
        made: list[UrRtde] = []

        def make(**more: Any) -> UrRtde:
            options = {"address": "127.0.0.1", "port": proxy.port, "limits_deg": [[-360, 360]] * 6, "silence_s": 3.0, **more}
            made.append(UrRtde("arm", "UR10e", options))
            return made[-1]

        def use(robot: Any) -> None:
            target = np.radians(HOME_DEG if np.abs(np.degrees(robot.state().q) - HOME_DEG).max() > 0.5 else HOME_DEG + 2)
            robot.move_to(target, LIMITS)
            while not robot.state().arrived:
                time.sleep(0.002)  # proxy and fake run in this process too
            assert np.abs(fake.q - target).max() < 2e-4, "arrived, but the arm is elsewhere"

        def begin(robot: Any) -> None:
            robot.move_to(np.radians(HOME_DEG + 170), LIMITS)

        yield Stand(
            make, use, {"rtde": proxy}, begin=begin, at_rest=lambda: fake.at_rest, short_limits={"silence_s": 0.5, "connect_timeout_s": 1.0}
        )
        for robot in made:
            robot.close()


BENCH = DriverBench("ur_rtde_example", "robot", opened, excused=EXCUSED)


def main() -> int:
    """Exit status 0 where no check failed."""
    results = []
    for result in run(BENCH):
        results.append(result)
        print(result)
    failed = sum(r.status == "failed" for r in results)
    print(f"{len(results)} checks, {failed} failed")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
