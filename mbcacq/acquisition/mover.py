"""One checked joint motion, from command to standstill."""

from __future__ import annotations

import time

import numpy as np

from mbcacq.acquisition.cycle_collector import CycleCollector
from mbcacq.devices import MotionLimits, Robot, RobotState, SafetyStop
from mbcacq.model.cell import Cell
from mbcacq.plan.motion_limits import arms_beyond, check_target, longest_duration
from mbcacq.quantities import in_degrees

POLL_S = 0.003
MOVED = 1e-4  # rad; less is no motion that could bring a gear to its other flank


class Mover:
    """Moves the arm and remembers from which side each axis arrived."""

    def __init__(self, robot: Robot, cell: Cell, limits: MotionLimits, collector: CycleCollector) -> None:
        self._robot, self._model, self.limits, self._collector = robot, cell.robot, limits, collector
        self._arms = arms_beyond(cell)
        self.direction = np.zeros(cell.robot.n, dtype=int)

    def summary(self) -> str:
        """What the end of a run says of its motions, as a clause: nothing, as every pose was reached within its tolerance."""
        return ""

    def pass_by(self, waypoint: np.ndarray) -> None:
        """Move by a waypoint (n,) rad on the way to a pose. Raises as ``go``."""
        self.go(waypoint)

    def state(self) -> RobotState:
        """What the arm does now. Raises what stopped it."""
        return self._robot.state()

    def go(self, target: np.ndarray, limits: MotionLimits | None = None) -> RobotState:
        """Move to ``target`` (n,) rad, wait until the measured joints stand there; limits: in place of the run's. Raises what stopped the
        arm."""
        limits = limits or self.limits
        check_target(target, self._model)
        start = self._robot.state()
        travel = target - start.q
        self.direction = np.where(np.abs(travel) > MOVED, np.sign(travel), self.direction).astype(int)
        self._robot.move_to(target, limits)
        deadline = start.time_s + longest_duration(travel, limits, self._arms)
        while True:
            self._collector.check()
            state = self._robot.state()
            if state.arrived:
                return state
            if state.time_s > deadline:
                self._robot.stop()
                away = in_degrees(np.max(np.abs(target - state.q)))
                raise SafetyStop(
                    f"the arm did not arrive in time ({away:.3f}° away) and was stopped; is its path free, is the override 100 %?"
                )
            time.sleep(POLL_S)
