"""One move over RSI, as a program: prints what the driver recorded, or the error that ended the move, as JSON. Arguments: address, port,
target of A1 in deg, late_limit."""

import json
import sys
import time

import numpy as np
from kuka_bench import HOME_DEG, LIMITS_DEG, motion_limits
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.devices import MbcacqError

address, port, target, late_limit = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
options = {
    "limits_deg": LIMITS_DEG,
    "bind": address,
    "port": port,
    "controller_ip": "" if address.startswith("127.") else address.rsplit(".", 1)[0] + ".1",
    "late_limit": late_limit,
    "connect_timeout_s": 60.0,
    "silence_s": 20.0,
}
with KukaRsi("arm", "", options) as robot:
    goal = np.radians(HOME_DEG + [target, 0, 0, 0, 0, 0])
    robot.move_to(goal, motion_limits(speed=20.0, acceleration=100.0))
    deadline, error = time.monotonic() + 600.0, ""
    try:
        while not robot.state().arrived:
            assert time.monotonic() < deadline
            time.sleep(0.005)
    except MbcacqError as found:
        error = f"{type(found).__name__}: {found}"
    columns = robot.cycles().columns
print(
    json.dumps(
        {
            "error": error,
            "command": np.degrees(columns["q_command"][:, 0]).tolist(),
            **{name: columns[name].tolist() for name in ("ipoc", "delay", "lost_telegrams", "repeated_telegrams", "old_telegrams")},
        }
    )
)
