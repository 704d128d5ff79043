"""Other orders of a gear's error that the poses do not tell from the reported one: between few angles, many orders look alike."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.evidence.candidate_evidence import log_factors, log_weights, refined
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, Member, conditioned
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.effects.in_words import odds_in_words
from mbcacq.effects.pose import gear_transmission_error

MOST_TRIED = 6  # highest peaks of the scan that are refined


def aliased(setup: DiagnosisProblem, reported: Hypothesis) -> list[str]:
    """A sentence for each reported order that others equal."""
    out = []
    for member in reported.members:
        if member.candidate.name != gear_transmission_error.NAME:
            continue
        others = equal_orders(setup, reported, member)
        if others:
            named = ", ".join(f"{order:.4g} ({odds_in_words(odds)})" for order, odds in others)
            at = member.candidate.where[0]
            out.append(f"{member.candidate.name} at {at}, order {member.hyper:.4g}: by these poses it is as well of order {named}")
    return out


def equal_orders(setup: DiagnosisProblem, reported: Hypothesis, member: Member) -> list[tuple[float, float]]:
    """Orders in the place of a member's, and their odds against it, where these are above a twentieth; most probable first.

    Orders closer than one period over the joint's travel are no others: they are its own uncertainty.
    """
    candidate, own = member.candidate, float(member.hyper or 0.0)
    assert candidate.hyper is not None, "the error of a gear has an order"
    node = conditioned(reported.point, tuple(m for m in reported.members if m is not member))
    grid = np.sort(candidate.hyper.values)
    logs = log_factors(node, candidate, grid)
    around = np.concatenate([[-np.inf], logs, [-np.inf]])
    peaks = np.flatnonzero((logs > around[:-2]) & (logs >= around[2:]))
    resolution = 2 * np.pi / float(np.ptp(setup.context.value(candidate.depends_on)))
    apart = [int(j) for j in peaks if abs(grid[j] - own) > resolution]
    weight = dict(zip(grid, log_weights(candidate, grid), strict=True))
    reference = float(log_factors(node, candidate, np.array([own]))[0]) + weight.get(own, float(min(weight.values())))
    found = []
    for j in sorted(apart, key=lambda j: -logs[j])[:MOST_TRIED]:
        _, (order, log) = refined(node, candidate, float(grid[max(j - 1, 0)]), float(grid[min(j + 1, len(grid) - 1)]))
        odds = float(np.exp(min(log + weight.get(order, float(min(weight.values()))) - reference, 0.0)))
        if odds > OPTIONS.undecided:
            found.append((order, odds))
    return sorted(found, key=lambda one: -one[1])
