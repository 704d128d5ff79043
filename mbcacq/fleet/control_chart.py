"""Control charts of a fleet: each arm's figures over time, and the arms of one type beside each other.

An individuals chart (Shewhart; ISO 7870-2): the centre line is the median of an arm, weighted by precision. The variance of a recording is
that stated by its calibration plus that of the changes of arms of the type from one recording to the next. The latter is such that the
median moving range is as expected (Wheeler), which a drift or a few outliers do not widen. Arms are compared with each other in the same
way. Limits are quantiles of Student's t, with the degrees of freedom of the variance (Welch, Satterthwaite). A fleet without any change
then has a recording in 370 outside of them, over all of its figures, and an arm in 370.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtrit

from mbcacq.fleet.drift import drifts
from mbcacq.fleet.row import EVALUATED, FleetRow, estimates_of
from mbcacq.report.several import ControlChart

FALSE_ALARMS = 0.0027  # of a recording, and of an arm among the others: three standard deviations of a single figure
MEDIAN = 0.6745  # median of the absolute value of a standard normal variable
EFFICIENCY = 0.37  # of a variance estimated by a median of absolute deviations, against the sum of squares
OF_MEDIAN = float(np.pi / 2)  # variance of a median over that of a mean
FEWEST = 4  # fewer moving ranges, or arms, say nothing about their variance
FURTHER = ("rms_mm", "spacing_max_mm")  # figures that are charted besides the parameters


@dataclass(frozen=True)
class ArmType:
    """The evaluated recordings of one type of arm, sorted by arm and time, and the chart of each figure."""

    robot: str
    rows: tuple[FleetRow, ...]
    charts: tuple[ControlChart, ...]


@dataclass(frozen=True)
class Outlier:
    """A figure of a recording (or, ``recording`` None, of an arm) outside the limits; in mm or rad. drift: from an arm's first recording
    to its last, instead of a level.
    """

    arm: str
    recording: str | None
    name: str
    value: float
    centre: float
    limit: float
    drift: bool = False


def arm_types(rows: Sequence[FleetRow]) -> list[ArmType]:
    """The types of arm with their charts; arms of one name with another nominal geometry are another type."""
    groups: dict[tuple[str, tuple[float, ...]], list[FleetRow]] = {}
    for row in rows:
        if row.status == EVALUATED:
            groups.setdefault((row.robot or "", row.nominal), []).append(row)
    return [_arm_type(robot, here) for (robot, _), here in sorted(groups.items(), key=lambda g: g[0][0])]


def _arm_type(robot: str, rows: list[FleetRow]) -> ArmType:
    rows = sorted(rows, key=lambda r: (r.arm, r.time or "", r.recording))
    arms = tuple(dict.fromkeys(row.arm for row in rows))
    arm = np.array([arms.index(row.arm) for row in rows])
    series = {name: estimates_of(rows, name) for name in dict.fromkeys(name for row in rows for name in row.estimates)}
    series |= {name: (np.array([getattr(row, name) for row in rows], dtype=float), np.zeros(len(rows))) for name in FURTHER}
    series = {name: s for name, s in series.items() if np.isfinite(s[0]).any()}
    share = FALSE_ALARMS / max(len(series), 1)  # all figures of a recording share it
    charts = tuple(control_chart(name, value, std, arm, arms, share) for name, (value, std) in series.items())
    return ArmType(robot, tuple(rows), charts)


def control_chart(name: str, value: np.ndarray, std: np.ndarray, arm: np.ndarray, arms: tuple[str, ...], share: float) -> ControlChart:
    """The chart of one figure; recordings are sorted by arm and time. share: false-alarm rate of each limit."""
    known = np.isfinite(value)
    at = np.flatnonzero(known)
    same = np.flatnonzero(arm[at][1:] == arm[at][:-1])
    first, second = at[same], at[same + 1]
    change = excess_variance(value[second] - value[first], std[first] ** 2 + std[second] ** 2) / 2
    variance = np.nan_to_num(change) + std**2
    middle, of_middle = np.full(len(arms), np.nan), np.full(len(arms), np.nan)
    single = np.zeros(len(arms), bool)
    for a in range(len(arms)):
        here = known & (arm == a)
        if here.any():
            weight = 1 / np.maximum(variance[here], 1e-300)
            middle[a], of_middle[a] = weighted_median(value[here], weight), OF_MEDIAN / weight.sum()
            single[a] = here.sum() == 1
    limit = half_width(share, variance + of_middle[arm], change, len(same))
    limit[single[arm] | ~known] = np.nan
    there = np.isfinite(middle)
    usual = float(np.median(middle[there]))
    among = excess_variance(middle[there] - usual, of_middle[there])
    arm_limit = half_width(share, among + of_middle, among, int(there.sum()))
    return ControlChart(
        name=name,
        value=value,
        std=std,
        arm=arm,
        arms=arms,
        centre=middle[arm],
        limit=limit,
        arm_value=middle,
        arm_limit=arm_limit,
        usual=usual,
    )


def excess_variance(deviation: np.ndarray, stated: np.ndarray) -> float:
    """The variance v that deviations (K,) have beyond the stated one (K,): with it, the median of the normalised ones is as expected.

    NaN for fewer than FEWEST.
    """
    size = np.abs(deviation)
    if len(size) < FEWEST:
        return np.nan

    def missing(v: float) -> float:
        return float(np.median(size / np.sqrt(np.maximum(v + stated, 1e-300)))) - MEDIAN

    if missing(0.0) <= 0:
        return 0.0
    return float(brentq(missing, 0.0, (2 * float(size.max()) / MEDIAN) ** 2))  # pyright: ignore[reportArgumentType] -- a root, no report


def half_width(share: float, variance: np.ndarray, estimated: float, count: int) -> np.ndarray:
    """(K,) half widths of limits with ``share`` outside. variance: (K,), of which ``estimated`` comes from a median of ``count`` values."""
    if not np.isfinite(estimated):
        return np.full(len(variance), np.nan)
    dof = EFFICIENCY * count * (variance / estimated) ** 2 if estimated > 0 else np.full(len(variance), np.inf)
    return -stdtrit(dof, share / 2) * np.sqrt(variance)


def weighted_median(value: np.ndarray, weight: np.ndarray) -> float:
    """The value at which half of the weight is below; midway between two values where it falls between them."""
    order = np.argsort(value)
    below = np.cumsum(weight[order]) / weight.sum()
    k = int(np.searchsorted(below, 0.5 - 1e-12))
    between = k + 1 < len(value) and abs(below[k] - 0.5) < 1e-12
    return float((value[order[k]] + value[order[k + 1]]) / 2) if between else float(value[order[k]])


def outliers(types: Sequence[ArmType]) -> list[Outlier]:
    """All that is outside its limits: recordings against their arm, arms against the others of their type and against standing still, the
    farthest out first.
    """
    out = []
    for kind in types:
        out += [Outlier(d.arm, None, d.name, d.change, 0.0, d.limit, drift=True) for d in drifts(kind.rows)]
        for chart in kind.charts:
            for k in np.flatnonzero(chart.outside):
                value, centre, limit = (float(each[k]) for each in (chart.value, chart.centre, chart.limit))
                out.append(Outlier(kind.rows[k].arm, kind.rows[k].recording, chart.name, value, centre, limit))
            for a in np.flatnonzero(chart.unusual):
                out.append(Outlier(chart.arms[a], None, chart.name, float(chart.arm_value[a]), chart.usual, float(chart.arm_limit[a])))
    return sorted(out, key=lambda o: -abs(o.value - o.centre) / o.limit if o.limit > 0 else -np.inf)
