"""What the catalogue leaves out for a recording although the cell may have it: a name among the few that were tried may be wrong.

An error of a gear is claimed to be periodic only where the joint travels far enough, and weight is known only where masses are. An effect
that is left out for such a reason may still act. It stands as a smooth function at its location, so that no effect that was tried is
named with confidence where such a function does as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, StandstillRows
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.functions import DescribedPart, cosine, linear, sine
from mbcacq.quantities import in_degrees

ORDERS_OF_CONSTRUCTION = (1.0, 2.0)  # periods a turn of eccentric wheels and of their ovality: any gear may have them
VARIES = 0.02  # share of the largest torque, below which a joint feels no weight


@dataclass(frozen=True)
class UntriedEffect:
    """A smooth function that stands for an effect that was not tried.

    candidate: without a name; name: of the effect of the catalogue that it stands for; reason: why that was not tried, as the end of a
    sentence.
    """

    candidate: Candidate
    name: str
    reason: str


def untried(context: Context, candidates: Sequence[Candidate]) -> list[UntriedEffect]:
    """Effects that ``candidates`` of a recording lack at the joints: orders of gears that the travel does not cover, weight of unknown
    masses."""
    slow = [found for c in candidates if c.periodic and (found := _slow_orders(context, c)) is not None]
    return slow if context.masses_known else [*slow, *_weights(context)]


def _slow_orders(context: Context, candidate: Candidate) -> UntriedEffect | None:
    """The orders of the construction of a gear that a periodic candidate at a joint does not try."""
    assert candidate.hyper is not None, "a periodic effect has an order"
    missing = [order for order in ORDERS_OF_CONSTRUCTION if not np.any(np.isclose(candidate.hyper.values, order))]
    parts = candidate.parts(float(candidate.hyper.values[0]))
    if not missing or len(parts) != 1 or not isinstance(parts[0], DescribedPart):
        return None
    part, on = parts[0], candidate.depends_on
    columns = tuple(column for order in missing for column in (sine(on, order), cosine(on, order)))
    described = [DescribedPart(part.place, part.index, part.component, columns)]
    span = in_degrees(np.ptp(context.value(on)))
    named = " and ".join(f"{order:g}" for order in missing)
    reason = f"order {named} is not tried over {span:.0f}° of travel"
    typical = np.tile(candidate.typical, len(missing))
    return UntriedEffect(_unnamed(candidate.where, on, described, typical, "slow orders"), candidate.name, reason)


def _weights(context: Context) -> list[UntriedEffect]:
    """At each joint what any weight at the flange, and of links of equal mass, turns it by; of an elastic gearbox, in rad."""
    torque, out = context.gravity_torque, list[UntriedEffect]()
    for i in range(context.n):
        spread = np.ptp(torque[:, i])
        if spread < VARIES * np.ptp(torque, axis=0).max() + 1e-9:
            continue  # a vertical axis feels no weight
        names = [f"gravity_torque_{context.tags[i]}", *(f"payload_torque_{context.tags[i]}_{c}" for c in ("mass", "x", "y", "z"))]
        spreads = [float(np.ptp(context.value(name))) for name in names]
        columns = tuple(linear(name, 1.0 / s) for name, s in zip(names, spreads, strict=True) if s > 1e-9)
        described = [DescribedPart("joint", i, 0, columns)]
        reason = "no masses of the links are given"
        where = (context.axes[i],)
        candidate = _unnamed(where, f"gravity_torque_{context.tags[i]}", described, np.full(len(columns), 5e-5), "unknown masses")
        out.append(UntriedEffect(candidate, "joint_compliance", reason))
    return out


def _unnamed(where: tuple[str, ...], on: str, described: list[DescribedPart], typical: np.ndarray, variant: str) -> Candidate:
    """It has no parameters to report."""
    return Candidate(UNKNOWN, where, on, StandstillRows(described, typical), lambda c, v, h: {}, several=True, variant=variant)
