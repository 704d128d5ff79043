"""The actual angle follows the set point late: a pure delay and a first-order lag, told apart by the acceleration."""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run

NAME = "drive_lag"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "q_set":
        return []
    return [Candidate(NAME, (channel.axis,), f"qd{channel.joint + 1}", _columns,
                      lambda c, v, _: _report(channel.axis, c, v), positive=True)]


def _columns(run: Run, joint: int, _: float | None) -> np.ndarray:
    # q - q_set = -(L + T) q_set' + (L^2/2 + L T + T^2) q_set'' - ... for a delay L behind a lag T; with q_set' = q' + (L + T) q''
    # to the same order this is -(L + T) q' - (L^2/2 + L T) q''.
    return np.stack([-run.qd[:, joint], -run.qdd[:, joint]], axis=1)


def _report(axis: str, c: np.ndarray, v: np.ndarray) -> dict:
    total, curvature = float(c[0]), float(c[1])
    # c1 = (total^2 - T^2) / 2, hence T.
    square = total**2 - 2.0 * curvature
    lag = float(np.sqrt(max(square, 0.0)))
    lag = min(lag, max(total, 0.0))
    slope = np.array([total, -1.0]) / max(lag, 1e-4)
    std_lag = float(np.sqrt(slope @ v @ slope))
    return {
        f"{axis}.latency_s": {"value": total - lag, "std": float(np.hypot(np.sqrt(v[0, 0]), std_lag))},
        f"{axis}.time_constant_s": {"value": lag, "std": std_lag},
    }
