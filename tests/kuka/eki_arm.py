"""Where the arm of the EKI tests goes, and how they see that it is under way or stands."""

import time

import numpy as np
from eki_bench import START_DEG
from kuka_bench import motion_limits, wait

HOME_DEG = np.array(START_DEG)
HOME, FAR, SLOW = np.radians(HOME_DEG), np.radians(HOME_DEG + [4.9, 0, 0, 0, 0, 0]), motion_limits(speed=8.0)


def stands(fake):
    wait(lambda: fake.state.read().standstill)
    before = fake.state.read().q
    time.sleep(0.05)
    return np.allclose(fake.state.read().q, before, rtol=0, atol=1e-7)


def on_the_way(fake, robot):
    """So slow that a busy computer, too, does what follows before the arm is there."""
    fake.inject(override=5)
    robot.move_to(FAR, SLOW)
    wait(lambda: np.degrees(robot.state().q[0]) > 0.3)
