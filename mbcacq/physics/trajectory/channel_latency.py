"""Two channels were not sampled at one instant: the late one shows the past, so it differs by -latency times the rate."""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, value

NAME = "channel_latency"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name == "tau":
        return [Candidate(NAME, ("tau",), "rate", _torque, lambda c, v, _: value("latency_s", c[0], v[0, 0]), shared=True)]
    # q_joint - q = -latency * qd; the mismatch of the set point is q - q_set, so a late set point shows with the other sign.
    sign = -1.0 if channel.name == "q_joint" else 1.0
    return [Candidate(
        NAME, (channel.name,), f"qd{channel.joint + 1}",
        lambda run, joint, _: sign * run.qd[:, [joint]], lambda c, v, _: value("latency_s", c[0], v[0, 0]), shared=True,
    )]


def _torque(run: Run, joint: int, _: float | None) -> np.ndarray:
    return -np.gradient(run.torque[:, joint], run.step_s)[:, None]
