"""Which of the many joint positions of each target to take: the cheapest way through all of them."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel

LIMIT_MARGIN = np.radians(5.0)
SINGULAR = np.radians(12.0)
OVERHEAD_S = 20.0
DEFAULT_SPEED = np.radians(180.0)  # rad/s, for arms whose source gives none


def cheapest(start: np.ndarray, options: list[np.ndarray], restart: list[bool], robot: RobotModel, speed: np.ndarray) -> list[int]:
    """Index of the option to take at each pose, by dynamic programming over the sequence.

    start: (n,) rad, the home position; options: per pose (k, n) rad, k >= 1; restart: True where the arm comes from home instead of
    from the pose before (the artefact was moved). The cost of a motion is the time its slowest joint needs at full speed; positions
    near a limit, with a nearly straight wrist, or that reach over the arm's back where home does not, cost extra.
    """
    if not options:
        return []
    came_from: list[np.ndarray] = []
    cost = np.zeros(1)
    before, front = start[None], reaches_forward(robot.chain, start[None])[0]
    for here, again in zip(options, restart, strict=True):
        if again:
            came_from.append(np.full(len(here), int(np.argmin(cost))))
            base = cost.min() + _travel(start[None], here, speed)[0]
        else:
            total = cost[:, None] + _travel(before, here, speed)
            came_from.append(total.argmin(axis=0))
            base = total.min(axis=0)
        overhead = OVERHEAD_S * (reaches_forward(robot.chain, here) != front)
        cost, before = base + _penalty(here, robot.limits) + overhead, here
    chosen = [int(np.argmin(cost))]
    for back in came_from[:0:-1]:
        chosen.append(int(back[chosen[-1]]))
    return chosen[::-1]


def reaches_forward(chain: Chain, q: np.ndarray) -> np.ndarray:
    """(P,) bool: the last axis lies on the side of axis 1 that the arm faces, not behind it."""
    frames = chain.frames(q)
    return np.einsum("pi,pi->p", frames[:, 1, :3, 0], frames[:, -2, :3, 3]) >= 0


def _travel(a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """(len(a), len(b)) s; the mean over the joints breaks ties between motions with the same slowest joint."""
    time = np.abs(b[None] - a[:, None]) / speed
    return time.max(axis=2) + 0.2 * time.mean(axis=2)


def _penalty(q: np.ndarray, limits: np.ndarray) -> np.ndarray:
    room = np.minimum(q - limits[:, 0], limits[:, 1] - q).min(axis=1)
    straight = np.abs(q[:, 4]) if q.shape[1] == 6 else np.full(len(q), np.inf)
    return 20 * np.clip(1 - room / LIMIT_MARGIN, 0, 1) + 20 * np.clip(1 - straight / SINGULAR, 0, 1)
