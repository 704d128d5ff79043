"""The posterior of the order of a periodic error over all its peaks: at few angles, or over few turns, many orders look alike.

A standard deviation within one peak says nothing of the others. Angles that were visited have a window: orders that differ by a whole
number are aliases where a joint was seen over a turn or two, and every multiple of the spacing is one where it stood at few angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import log_factors, log_weights, refined
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import covariates
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate

LEAST_APART = 0.25  # of two orders that are two causes
SMOOTHED = 0.1  # share of its log Bayes factor by which a peak may be higher than at the nearest of four values a period over the travel
MOST_REFINED = 25  # peaks
CURVATURE = 0.02  # of the resolution: the step of the second difference that gives the width of a peak


@dataclass(frozen=True)
class OrderPeak:
    """One peak of the posterior of an order. odds: its posterior probability relative to the reported one's, at most 1."""

    order: float
    sigma: float
    odds: float


def resolution_of(hypothesis: Hypothesis, candidate: Candidate) -> float:
    """Distance of two orders that differ by one period over the travel of the angle."""
    return 2 * np.pi / max(float(np.ptp(covariates(hypothesis.point.linear).value(candidate.depends_on))), 1e-9)


def other_peaks(hypothesis: Hypothesis, member: Member) -> tuple[OrderPeak, ...]:
    """Orders in the place of a member's whose odds against it are above a twentieth; most probable first.

    Orders closer than one period over the travel are no others: they are its own uncertainty, but for those that a gear has by its
    construction.
    """
    candidate, own = member.candidate, float(member.hyper or 0.0)
    assert candidate.hyper is not None, "a periodic effect has an order"
    node = hypothesis.point.conditioned(tuple(m for m in hypothesis.members if m is not member))
    grid = np.sort(candidate.hyper.values)
    weight = dict(zip(grid, log_weights(candidate, grid), strict=True))
    between = min(weight.values())  # of an order between those of the grid
    resolution = resolution_of(hypothesis, candidate)

    logs = log_factors(node, candidate, grid)
    log_own = float(log_factors(node, candidate, np.array([own]))[0])
    around = np.concatenate([[-np.inf], logs, [-np.inf]])
    possible = logs > log_own + np.log(OPTIONS.undecided) - SMOOTHED * max(log_own, 0.0) - OPTIONS.resolved
    peaks = np.flatnonzero((logs > around[:-2]) & (logs >= around[2:]) & (np.abs(grid - own) > resolution) & possible)
    near = near_built_orders(candidate, own, resolution)
    others = list(zip(near, log_factors(node, candidate, np.array(near)).tolist(), strict=True)) if near else []
    for j in peaks[np.argsort(-logs[peaks])][:MOST_REFINED]:
        others.append(refined(node, candidate, float(grid[max(j - 1, 0)]), float(grid[min(j + 1, len(grid) - 1)]))[1])
    log_odds = [(order, log + weight.get(order, between) - log_own - weight.get(own, between)) for order, log in others]
    found = [(order, float(np.exp(min(log, 0.0)))) for order, log in log_odds]
    kept = sorted((one for one in found if one[1] > OPTIONS.undecided), key=lambda one: -one[1])
    return tuple(OrderPeak(order, width(node, candidate, order, resolution), odds) for order, odds in kept)


def width(node: CandidateScoring, candidate: Candidate, order: float, resolution: float) -> float:
    """Standard deviation of an order within its peak, by the curvature of the log Bayes factor."""
    step = CURVATURE * resolution
    low, middle, high = log_factors(node, candidate, order + step * np.array([-1.0, 0.0, 1.0]))
    bend = (2 * middle - low - high) / step**2
    return float(min(1 / np.sqrt(bend), resolution)) if bend > 0 else resolution


def near_built_orders(candidate: Candidate, own: float, resolution: float) -> list[float]:
    """Orders that a gear has by its construction, once and twice a turn above all, within the resolution of a reported one: those are no
    uncertainty of the order but another cause.
    """
    assert candidate.hyper is not None, "a periodic effect has an order"
    built = dict.fromkeys((1.0, 2.0, *candidate.hyper.preferred))
    return [order for order in built if LEAST_APART < abs(order - own) <= resolution]
