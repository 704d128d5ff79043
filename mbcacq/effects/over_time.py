"""What changes while a recording is measured: a step between two poses in the order of measurement, and an exponential warm-up."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context, rank_in_time
from mbcacq.effects.effect import FADING, MOMENT, Candidate, Hyperparameter
from mbcacq.model.observations import Observations

NAME = "at_pose"


def moment(context: Context) -> Hyperparameter:
    """The ranks in time that the first pose after the change may have: every pose up to 400, then evenly spread.

    Neighbouring moments split the poses nearly alike: independent ones are as many as the recording can be halved, a few times over.
    """
    margin = 2
    ranks = np.arange(margin, context.obs.n_poses - margin + 1)
    if len(ranks) > 400:
        ranks = ranks[:: int(np.ceil(len(ranks) / 400))]
    return Hyperparameter(NAME, ranks.astype(float), 6 * np.log(len(ranks)), refine=False, kind=MOMENT)


def indistinguishable_moments(candidate: Candidate, hyper: float | None, obs: Observations, seen: np.ndarray) -> list[float]:
    """Other moments that the centres ``seen`` (M,) bool cannot distinguish from this one, because none of their poses lies between. Empty
    for effects that have no moment.
    """
    if candidate.hyper is None or candidate.hyper.kind != MOMENT:
        return []
    ranks = np.unique(rank_in_time(obs)[obs.pose[seen]])
    before, after = ranks[ranks < hyper], ranks[ranks >= hyper]
    if not len(before) or not len(after):
        return []
    return [float(r) for r in range(int(before[-1]) + 1, int(after[0]) + 1) if r != hyper]


def pose_at(context: Context, rank: float) -> int:
    """Number of the pose (column ``pose``) that is the first after the change."""
    return int(context.obs.pose_id[np.flatnonzero(context.order == int(rank))[0]])


TIME_CONSTANT = "time_constant_s"


def time_constant(context: Context) -> Hyperparameter:
    """Time constants from a few hundredths to twice the duration of the recording."""
    total = float(np.ptp(context.time))
    return Hyperparameter(TIME_CONSTANT, np.geomspace(0.03 * total, 2.0 * total, 16), 2.0, kind=FADING)


def time_constant_std(tau: float, c: np.ndarray, v: np.ndarray) -> float:
    """Rough standard deviation of tau: the fading and its derivative by log tau are about equally large."""
    size = float(np.linalg.norm(c))
    return float(tau * 2.0 * np.sqrt(np.trace(v)) / max(size, 1e-30))
