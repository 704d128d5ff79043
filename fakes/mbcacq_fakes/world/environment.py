"""Temperatures of the fake cell in time, and its clock."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from mbcacq.devices import DriverOptions

SCANNER_WARMUP_K = 14.0  # of a housing that its electronics heat
SCANNER_SHARE = 0.4  # of the arm's time constant


class Environment(DriverOptions):
    """Air drifts slowly; the arm warms up towards ``warmup_K`` above the air with ``time_constant_s`` from switch-on.

    time_scale: seconds of the cell's day per second of robot time, so that a short run can see slow things happen.
    start_s: how long the cell had been on when the robot's clock began. All deg C, s.
    """

    air_C: float = 21.0
    air_drift_K: float = 0.8
    air_period_s: float = Field(default=9000.0, gt=0)
    warmup_K: float = 9.0
    time_constant_s: float = Field(default=2700.0, gt=0)
    start_s: float = Field(default=0.0, ge=0)
    time_scale: float = Field(default=1.0, gt=0)

    def clock(self, robot_time_s: np.ndarray) -> np.ndarray:
        """Time of the cell's day for the robot's own clock."""
        return self.start_s + self.time_scale * np.asarray(robot_time_s, dtype=float)

    def air(self, time_s: np.ndarray) -> np.ndarray:
        return self.air_C + self.air_drift_K * np.sin(2 * np.pi * np.asarray(time_s) / self.air_period_s)

    def robot(self, time_s: np.ndarray) -> np.ndarray:
        return self.air(time_s) + self.warmup_K * -np.expm1(-np.asarray(time_s) / self.time_constant_s)

    def scanner(self, time_s: np.ndarray) -> np.ndarray:
        """Its housing: it warms up more than the arm, and faster."""
        return self.air(time_s) + SCANNER_WARMUP_K * -np.expm1(-np.asarray(time_s) / (SCANNER_SHARE * self.time_constant_s))
