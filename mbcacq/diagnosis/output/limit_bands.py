"""For which values of its hyper-parameter a limit of an effect holds: bands of orders, all moments but those that cannot be seen.

The information of a recording differs a hundredfold between the orders of a gear, and between moments within a station and those at which
the station changes. One limit for all of them would say nothing of most, and one for a value in the middle is false for the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.effects.effect import BREAKPOINT, FADING, MOMENT, Candidate

ORDERS = (1.0, 1.5, 2.5, 5.0, 15.0, 50.0, np.inf)  # ends of the bands: the first and the second order trade with geometry and elasticity
SLOW = tuple(np.arange(20, 50) / 20)  # orders that are looked at whether or not a search would claim them
ALONE = (1.0, 2.0)  # orders that have a limit of their own, as those have that the gear has by its construction: few gears have others
ALIKE = 3.0  # standard deviations of a band's values are up to this many times their median


@dataclass(frozen=True)
class LimitBand:
    """Values (H,) of a hyper-parameter; one of None where there is none. left_out: values between them for which no limit holds."""

    values: tuple[float | None, ...]
    left_out: tuple[float, ...] = ()


def bands(candidate: Candidate, found: Sequence[float] = ()) -> list[LimitBand]:
    """Bands of a candidate, before anything is known of how well its values are determined. found: orders that are reported at its
    location, in whose bands nothing is limited.
    """
    hyper = candidate.hyper
    if hyper is None:
        return [LimitBand((None,))]
    if not candidate.periodic:
        return [LimitBand(tuple(np.sort(hyper.values).tolist()))]
    orders = np.unique(np.concatenate([hyper.values, SLOW, hyper.preferred]))
    alone = np.isin(orders, (*ALONE, *hyper.preferred))
    out = []
    for low, high in zip(ORDERS[:-1], ORDERS[1:], strict=True):
        inside = (orders >= low) & (orders < high)
        if any(low <= one < high for one in found):
            continue
        out += [LimitBand((float(order),)) for order in orders[inside & alone]]
        if np.any(inside & ~alone):
            out.append(LimitBand(tuple(orders[inside & ~alone].tolist())))
    return out


def alike(candidate: Candidate, band: LimitBand, std: np.ndarray) -> np.ndarray:
    """(H,) bool of the values of a band for which one limit is stated. std (H,): of the worst direction of the coefficients.

    At the others a change hides: a moment at which the station changes, a breakpoint at which the effect is what another one is.
    """
    if candidate.hyper is None or candidate.hyper.kind not in (MOMENT, BREAKPOINT, FADING):
        return np.ones(len(band.values), dtype=bool)
    return std <= ALIKE * np.median(std)


def kept(band: LimitBand, chosen: np.ndarray) -> LimitBand:
    """The band with the values that are chosen (H,) bool."""
    if chosen.all():
        return band
    values = np.array(band.values, dtype=float)
    mine = values[chosen]
    between = values[~chosen & (values > mine.min()) & (values < mine.max())]
    return LimitBand(tuple(mine.tolist()), tuple(between.tolist()))
