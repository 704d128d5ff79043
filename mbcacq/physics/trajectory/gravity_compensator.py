"""A spring or gas balancer at A2 that the rigid-body model leaves out.

Its torque depends on q2 alone: a spring between a point of the base and one of the link gives sines of q2 and, through its changing
length, their harmonics; the first ones look like mass, the higher ones like nothing a rigid arm can do.
"""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run

NAME = "gravity_compensator"
NAMES = ("sin_Nm", "cos_Nm", "sin2_Nm", "cos2_Nm")


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "tau" or channel.joint != 1:
        return []
    return [Candidate(NAME, ("A2",), "q2", _columns, lambda c, v, _: {
        f"A2.{name}": {"value": float(c[k]), "std": float(np.sqrt(v[k, k]))} for k, name in enumerate(NAMES)})]


def _columns(run: Run, joint: int, _: float | None) -> np.ndarray:
    q = run.q[:, joint]
    return np.stack([np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)], axis=1)
