"""Which of the joint positions that reach each target to take: the sequence of least cost, by dynamic programming."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.plan.planned import LoadedPlan


def select_solutions(loaded: LoadedPlan, options: list[np.ndarray], restart: list[bool]) -> list[int]:
    """Index of the option to take at each pose.

    options: per pose (k, n) rad, k >= 1; restart: True where the arm comes from home instead of from the pose before (the artefact was
    moved). The cost of a motion is the time its slowest joint needs at full speed. Positions near a limit, with a nearly straight wrist, or
    that reach over the arm's back where home does not, cost extra.
    """
    if not options:
        return []
    robot, limits = loaded.cell.robot, loaded.planning
    home = loaded.plan.robot.home
    speed = _speed(loaded)
    came_from: list[np.ndarray] = []
    cost = np.zeros(1)
    before, front = home[None], reaches_forward(robot.chain, home[None])[0]
    for here, again in zip(options, restart, strict=True):
        if again:
            came_from.append(np.full(len(here), int(np.argmin(cost))))
            base = cost.min() + _motion_cost(home[None], here, speed, limits.mean_joint_share)[0]
        else:
            total = cost[:, None] + _motion_cost(before, here, speed, limits.mean_joint_share)
            came_from.append(total.argmin(axis=0))
            base = total.min(axis=0)
        reach_back = limits.reach_back_s * (reaches_forward(robot.chain, here) != front)
        cost, before = base + _posture_cost(loaded, here) + reach_back, here
    chosen = [int(np.argmin(cost))]
    for back in came_from[:0:-1]:
        chosen.append(int(back[chosen[-1]]))
    return chosen[::-1]


def cheapest_from_home(loaded: LoadedPlan, options: list[np.ndarray]) -> list[int]:
    """Index of the position that ``select_solutions`` takes of each set (k, n) rad where the arm comes from home; 0 of an empty set."""
    every = np.concatenate([np.empty((0, loaded.cell.robot.n)), *options])
    if not len(every):
        return [0] * len(options)
    cost = _from_home(loaded, every)
    ends = np.cumsum([len(q) for q in options])
    return [int(np.argmin(of)) if len(of) else 0 for of in np.split(cost, ends[:-1])]


def _from_home(loaded: LoadedPlan, q: np.ndarray) -> np.ndarray:
    """(k,) s: cost of positions (k, n) rad to which the arm comes from home."""
    robot, home = loaded.cell.robot, loaded.plan.robot.home[None]
    motion = _motion_cost(home, q, _speed(loaded), loaded.planning.mean_joint_share)[0]
    front = reaches_forward(robot.chain, home)[0]
    reach_back = loaded.planning.reach_back_s * (reaches_forward(robot.chain, q) != front)
    return motion + _posture_cost(loaded, q) + reach_back


def _speed(loaded: LoadedPlan) -> np.ndarray:
    """(n,) rad/s."""
    robot = loaded.cell.robot
    return np.full(robot.n, loaded.planning.assumed_top_speed) if robot.speed is None else robot.speed


def reaches_forward(chain: Chain, q: np.ndarray) -> np.ndarray:
    """(P,) bool: the last axis lies on the side of axis 1 that the arm faces, not behind it."""
    link = chain.link_transforms(q)
    tip = link[:, -2, :3, 3]  # origin of the frame of the last axis, brought back link by link to the frame behind axis 1
    first = chain.first_turning
    for i in range(chain.n - 3, first, -1):
        tip = se3.apply(link[:, i], tip)
    return np.einsum("pi,pi->p", link[:, first, :3, 0], se3.apply(link[:, first], tip)) >= 0


def wrist_bend(chain: Chain, q: np.ndarray) -> np.ndarray:
    """(P,) rad between the lines of the last axis and the last but two, within a quarter turn: 0 where the wrist is straight."""
    link = chain.link_transforms(q)
    x, y, z = np.einsum("pij,pj->ip", link[:, -3, :3, :3], link[:, -2, :3, 2])  # the last axis, where the last but two is z
    return np.arctan2(np.hypot(x, y), np.abs(z))


def _motion_cost(a: np.ndarray, b: np.ndarray, speed: np.ndarray, mean_joint_share: float) -> np.ndarray:
    """(len(a), len(b)) s; the mean over the joints decides between motions with the same slowest joint."""
    time = np.abs(b[None] - a[:, None]) / speed
    return time.max(axis=2) + mean_joint_share * time.mean(axis=2)


def _posture_cost(loaded: LoadedPlan, q: np.ndarray) -> np.ndarray:
    """(k,) s: grows as a position comes close to a limit, and as its wrist straightens."""
    joint_limits, planning = loaded.cell.robot.limits, loaded.planning
    own = slice(loaded.cell.robot.chain.first_turning, None)
    room = np.minimum(q - joint_limits[:, 0], joint_limits[:, 1] - q)[:, own].min(axis=1)
    bend = wrist_bend(loaded.cell.robot.chain, q)
    near_limit = np.clip(1 - room / planning.preferred_limit_margin, 0, 1)
    straight = np.clip(1 - bend / planning.preferred_wrist_bend, 0, 1)
    return planning.poor_posture_s * near_limit + planning.poor_posture_s * straight
