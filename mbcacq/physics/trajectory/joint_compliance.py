"""The gearbox winds up under torque: the joint side lags the motor side by compliance times torque.

The drive's torque contains the friction in front of the gear, which winds nothing up: a second term takes it out again.
"""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, sense, value

NAME = "joint_compliance"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "q_joint" or runs[0].torque is None:
        return []
    about = (NAME, (channel.axis,), f"tau{channel.joint + 1}")
    name = f"{channel.axis}.compliance_rad_per_Nm"
    return [
        Candidate(*about, lambda run, joint, _: -run.torque[:, [joint]], lambda c, v, _: value(name, c[0], v[0, 0]), positive=True),
        Candidate(*about, _behind_friction, lambda c, v, _: value(name, c[0], v[0, 0]), positive=True),
    ]


def _behind_friction(run: Run, joint: int, _: float | None) -> np.ndarray:
    return np.stack([-run.torque[:, joint], sense(run, joint), run.qd[:, joint]], axis=1)
