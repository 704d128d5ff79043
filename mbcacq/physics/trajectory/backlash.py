"""Play in the gearbox: the joint side hangs back by half the width, on the side it is driven from."""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, sense, value

NAME = "backlash"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "q_joint":
        return []
    width = f"{channel.axis}.width_deg"
    return [Candidate(NAME, (channel.axis,), f"direction_{channel.joint + 1}", lambda run, joint, _: -0.5 * sense(run, joint)[:, None],
                      lambda c, v, _: value(width, np.degrees(c[0]), np.degrees(1) ** 2 * v[0, 0]), positive=True)]
