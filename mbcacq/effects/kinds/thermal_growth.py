"""A link that grows with a recorded temperature or, where none is recorded, with the time since the first pose."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, StandstillRows, Support, number, plain_effect
from mbcacq.effects.functions import DescribedPart, Function, Product, of, scaled
from mbcacq.effects.over_time import time_constant, time_constant_std

NAME = "thermal_growth"
# Aluminium grows by 24e-6 of its length a kelvin, steel by half of that; joints warm up by 40 K at most, and the temperature that is
# recorded may be another one.
LARGEST_STRAIN = 24e-6 * 60.0
LIMIT = "no link of metal grows by so much of its length"
DECLARED = Declaration(acts_in_time=True, needs=("time_s", "temperature"), challenge=Challenge(number=9))


def candidates(context: Context) -> list[Candidate]:
    """For each link longer than 30 mm, its growth along itself with each temperature, or with time."""
    recorded = {k: v for k, v in context.obs.temperatures.items() if np.ptp(v) > 0.2}
    if not recorded and context.obs.time_s is None:
        raise Missing("neither temperatures nor times recorded")
    links = [i for i in range(context.n) if np.hypot(context.state.chain.a[i], context.state.chain.d[i]) > 30]
    out = [with_temperature(context, i, column, values) for i in links for column, values in recorded.items()]
    if not recorded:
        out += [with_warm_up(context, i) for i in links]
    return out


def direction(context: Context, i: int) -> np.ndarray:
    """Unit vector (3,) from the frame before link i to the one behind it, in the axes of the latter; it is the same at every angle."""
    chain = context.obs.cell.robot.chain
    one = chain.link_transforms(np.zeros((1, context.n)))[0, i]
    along = one[:3, :3].T @ one[:3, 3]
    return along / max(float(np.linalg.norm(along)), 1e-12)


def with_temperature(context: Context, i: int, column: str, temperature: np.ndarray) -> Candidate:
    along = direction(context, i)
    first = float(temperature[np.argmin(context.order)])
    change = (Product(1.0, (Function(column),)), Product(-first))
    parts = [DescribedPart("frame", i + 1, c, (scaled(change, along[c]),)) for c in range(3) if abs(along[c]) > 1e-6]
    largest = largest_growth(context, i) / max(float(np.ptp(temperature)), 1e-9)
    return plain_effect(
        NAME, [f"link{context.tags[i]}"], column, parts, {f"link{context.tags[i]}.growth_mm_per_K": 0.01}, support=Support(largest, LIMIT)
    )


def largest_growth(context: Context, i: int) -> float:
    """mm that link i can grow by."""
    chain = context.state.chain
    return LARGEST_STRAIN * float(np.hypot(chain.a[i], chain.d[i]))


def with_warm_up(context: Context, i: int) -> Candidate:
    along, hyper = direction(context, i), time_constant(context)
    used = [c for c in range(3) if abs(along[c]) > 1e-6]

    def described(tau):
        grown = (Product(1.0), *of("time", "decay", tau, factor=-1.0))
        return [DescribedPart("frame", i + 1, c, (scaled(grown, along[c]),)) for c in used]

    def report(c, v, tau):
        return {
            f"link{context.tags[i]}.growth_mm": number(c[0], np.sqrt(v[0, 0])),
            f"link{context.tags[i]}.time_constant_s": number(tau.value, time_constant_std(tau.value, c, v)),
        }

    support = Support(largest_growth(context, i), LIMIT)
    return Candidate(NAME, (f"link{context.tags[i]}",), "time", StandstillRows(described, np.array([0.1])), report, hyper, support=support)
