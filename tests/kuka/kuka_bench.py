"""What the tests of the KUKA drivers share: limits, and waiting for an arm."""

import time

import numpy as np

from mbcacq.devices import MotionLimits

LIMITS_DEG = [(-185, 185), (-140, 10), (-120, 168), (-350, 350), (-125, 125), (-350, 350)]
HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])


def motion_limits(speed=90.0, acceleration=360.0, jerk=3600.0, settle_s=0.1):
    return MotionLimits(*(np.radians(np.full(6, v)) for v in (speed, acceleration, jerk)), tolerance=2e-4, settle_s=settle_s)


def wait(condition, timeout_s=600.0):
    """A generous bound against hanging, not a statement about time."""
    deadline = time.monotonic() + timeout_s
    while not (result := condition()):
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.002)
    return result


def arrive(robot):
    return wait(lambda: (state := robot.state()).arrived and state)


def until_error(robot):
    """The error that stops the robot."""

    def error():
        try:
            robot.state()
        except Exception as found:
            return found
        return None

    return wait(error)
