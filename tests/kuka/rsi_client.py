"""One move over RSI, as a program: prints what the driver recorded, as JSON. Arguments: address, port, target of A1 in deg, late_limit."""

import json
import sys
import time

import numpy as np
from conftest import HOME_DEG, LIMITS_DEG, motion_limits
from mbcacq_kuka.rsi.driver import KukaRsi

address, port, target, late_limit = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
with KukaRsi(
    "arm",
    "",
    {"limits_deg": LIMITS_DEG, "bind": address, "port": port, "late_limit": late_limit, "connect_timeout_s": 30.0, "silence_s": 20.0},
) as robot:
    goal = np.radians(HOME_DEG + [target, 0, 0, 0, 0, 0])
    robot.move_to(goal, motion_limits(speed=20.0, acceleration=100.0))
    deadline = time.monotonic() + 60.0
    while not robot.state().arrived:
        assert time.monotonic() < deadline
        time.sleep(0.005)
    columns = robot.cycles().columns
print(
    json.dumps(
        {"ipoc": columns["ipoc"].tolist(), "delay": columns["delay"].tolist(), "command": np.degrees(columns["q_command"][:, 0]).tolist()}
    )
)
