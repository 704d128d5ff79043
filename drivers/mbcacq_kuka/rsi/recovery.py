"""After the controller ended a session: may the arm go on from where it stands now?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq_kuka.rsi.shared import RsiCommand

OFF_PATH_DEG = 1.0  # braking of the controller's own does not leave the path by more; a person who jogs does


@dataclass(frozen=True)
class PendingMove:
    """The last motion that was asked for: from ``start`` to ``target`` (6,) deg, straight in joint space."""

    start: np.ndarray
    target: np.ndarray
    command: RsiCommand


def off_path(now: np.ndarray, before: np.ndarray, pending: PendingMove | None) -> str:
    """Why the arm must not go on, or ''. now: where it stands (6,) deg; before: where it stood last."""
    nearest = before
    if pending is not None:
        travel = pending.target - pending.start
        length = float(travel @ travel)
        share = 0.0 if length == 0.0 else float(np.clip((now - pending.start) @ travel / length, 0.0, 1.0))
        nearest = pending.start + share * travel
    away = np.abs(now - nearest)
    axis = int(np.argmax(away))
    if away[axis] <= OFF_PATH_DEG:
        return ""
    return f"A{axis + 1} stands {away[axis]:.2f}° off the path that was interrupted, so the arm was moved meanwhile"
