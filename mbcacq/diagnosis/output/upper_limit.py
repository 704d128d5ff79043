"""Upper limit, with 95 % confidence, of a size whose direction, and whose hyper-parameter within a band, may be any.

One statement for the whole family is tested: "there is an effect of size A, with the direction of its coefficients and the value of its
hyper-parameter drawn at random". The statistic T is the largest likelihood ratio over the band, and A is excluded where so small a T, or a
smaller one, has a probability of at most 5 % (Neyman's construction). That probability is the product of two. For the value that is there,
it is the mean over values and directions of the noncentral chi2 distribution. For all others of the band, which noise alone moves, it is
that of the largest of n - 1 independent ones. So 95 % of the errors drawn from the family are below their limit: neither fewer, as at the
value that is determined best, nor all, as with the largest of the limits of each.

A limit that noise has made smaller than 84 % of recordings without any effect would have it counts as one of these (power-constrained
limits: Cowan, Cranmer, Gross, Vitells 2011, arXiv:1105.3166). Nothing is then excluded that the recording could not show.

The information of a recording differs a hundredfold between the orders of a gear, and between moments within a station and those at which
the station changes. A limit holds for a band of values. One limit for all values would be useless for most of them, and the limit of a
middle value is false for the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chdtri, chndtr, ndtr, ndtri

from mbcacq.effects.effect import BREAKPOINT, FADING, MOMENT, Candidate

LEVEL = 0.05  # probability that the limit is below the truth
LEAST_POWER = float(ndtr(-1.0))  # quantile of T without any effect, below which it counts as that
MANY = 400.0  # chi2 from which the root of a noncentral chi2 variable is a normal one
REACH, POINTS = 8.0, 161  # standard deviations about T, and points there, at which the distribution is tabulated
SHARES = 400  # of the least to the best determined members of a family
HALVINGS = 30  # to a share of 1e-9
DIRECTIONS = 256


def directions(k: int) -> np.ndarray:
    """(D, k) unit vectors, evenly or at random over all directions; opposite ones are alike."""
    if k == 1:
        return np.ones((1, 1))
    if k == 2:
        angle = np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    drawn = np.random.default_rng(k).standard_normal((DIRECTIONS, k))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def largest_ratio(c: np.ndarray, V: np.ndarray, positive: bool) -> np.ndarray:
    """(..,) T of estimates c (H, k, ..) with covariances V (H, k, k): the largest of c' inv(V) c over the band; for a coefficient that
    cannot be negative, the largest number of standard deviations.
    """
    if positive:
        return np.max(c[:, 0] / np.sqrt(V[:, 0, 0]).reshape(-1, *(1,) * (c.ndim - 2)), axis=0)
    return np.max(np.einsum("hk...,hkl,hl...->h...", c, np.linalg.inv(V), c), axis=0)


def independent_values(drawn: np.ndarray, k: int, positive: bool) -> float:
    """Number of independent values of a band whose largest ratio has the median of the ratios drawn (N,) without any effect."""
    return max(float(np.log(0.5) / np.log(_central(np.median(drawn), k, positive))), 1.0)


def upper_limit(largest: float, precision: np.ndarray, independent: float, k: int, positive: bool) -> float:
    """The size that is excluded at 95 %.

    largest: T of the recording. precision: inverse variance along each direction of each value of the band, any shape. independent: number
    of independent values of the band. k: coefficients of the size. positive: whether its one coefficient cannot be negative.
    """
    least = LEAST_POWER ** (1.0 / independent)
    t = max(largest, float(ndtri(least) if positive else chdtri(k, 1.0 - least)))
    missed = LEVEL / _central(t, k, positive) ** (independent - 1.0)
    middle = t if positive else np.sqrt(t)
    x = np.linspace(max(middle - REACH, 0.0), max(middle, 0.0) + REACH, POINTS)
    below = _noncentral(t, x, k, positive)
    root = np.sqrt(np.quantile(precision, (np.arange(SHARES) + 0.5) / SHARES) if np.size(precision) > SHARES else np.ravel(precision))
    low, high = 0.0, x[-1] / root.min()
    for _ in range(HALVINGS):
        size = (low + high) / 2
        low, high = (size, high) if np.interp(size * root, x, below).mean() > missed else (low, size)
    return high


def _central(t: float, k: int, positive: bool) -> float:
    """Probability that the ratio of one value is at most t without any effect."""
    return float(ndtr(t) if positive else chdtr(k, t))


def _noncentral(t: float, x: np.ndarray, k: int, positive: bool) -> np.ndarray:
    """The same with an effect of x (X,) standard deviations."""
    if positive:
        return ndtr(t - x)
    return chndtr(t, k, x**2) if t < MANY else ndtr(np.sqrt(t) - np.sqrt(x**2 + k - 1.0))


ORDERS = (1.0, 1.5, 2.5, 5.0, 15.0, 50.0, np.inf)  # ends of the bands: the first and the second order trade with geometry and elasticity
SLOW = tuple(np.arange(20, 50) / 20)  # orders that are looked at whether or not a search would claim them
ALONE = (1.0, 2.0)  # orders that have a limit of their own, as those have that the gear has by its construction: few gears have others
ALIKE = 3.0  # standard deviations of a band's values are up to this many times their median


@dataclass(frozen=True)
class LimitBand:
    """Values (H,) of a hyper-parameter; one of None if there is none. left_out: values between them for which no limit holds."""

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
