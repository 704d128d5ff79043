"""The simulated arm of a dry run, with seven axes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from mbcacq_fakes.cell.simulated_robot import SimulatedRobot
from mbcacq_fakes.protocols.krc.arm_state import ArmState

from mbcacq.conformance import Stand
from mbcacq.devices import MotionLimits

OPTIONS_OF_OTHERS = {"refuses_an_unknown_option": "it stands in for any driver and gets that driver's options"}
HOME = np.radians([0.0, 10, 0, -90, 0, 80, 5])
LIMITS = MotionLimits(*(np.radians(np.full(7, v)) for v in (60.0, 400.0, 4000.0)), settle_s=0.05)


@contextmanager
def simulated() -> Iterator[Stand]:
    with ArmState.create(tuple(HOME.tolist())) as state:

        def make(model: str = "arm", **more: Any) -> SimulatedRobot:
            return SimulatedRobot("arm", model, {"limits_deg": [[-170, 170]] * 7, "state": state, **more})

        def use(robot: SimulatedRobot) -> None:
            target = HOME if np.abs(robot.state().q - HOME).max() > 0.1 else HOME + 0.2
            robot.move_to(target, LIMITS)
            while not robot.state().arrived:
                pass
            assert np.abs(np.array(state.read().q) - target).max() < 1e-9

        def begin(robot: SimulatedRobot) -> None:
            robot.move_to(HOME + 1.0, LIMITS)

        yield Stand(make, use, begin=begin, at_rest=lambda: state.read().standstill)
