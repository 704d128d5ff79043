"""Orders of periodic errors as they are stated: one, several with the odds of each, or not determined.

What repeats between recordings of one arm is that a joint errs periodically, and how much. A line of its spectrum is stated where the
posterior over all peaks has few of them, each of them sharp, and where disjoint parts of the recording have it as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from mbcacq.diagnosis.effect_found import LINE, EffectFound, FoundAgain, PossibleOrder
from mbcacq.diagnosis.evidence.order_posterior import LEAST_APART, OrderPeak, other_peaks, resolution_of
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.nonparametric.joint_model import coefficients_of
from mbcacq.diagnosis.search.effect_columns import candidate_parts, covariates
from mbcacq.diagnosis.validation.found_again import jackknife, relative_spread
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.effects.unmodelled import OPTIONS as UNMODELLED
from mbcacq.quantities import K, in_degrees

MOST_PEAKS = 3  # that are stated with their odds; more say that the order is not determined
SHARPEST = 0.5  # expanded uncertainty from which an order is not determined: it does not tell one whole number from the next
ONE_PEAK = 0.4  # of the resolution, within which orders of two parts are one
ALIASES = 2.0  # orders, or one resolution, within which what parts have is the same line
RMS = "rms_deg"  # over the poses, of the error of a joint by its own angle: its fast lines, and what they leave
SLOW = UNMODELLED.slow_order  # orders below trade with geometry and gravity, and are no part of that
PARTS_OF_TRAVEL = 4  # with equally many poses, between which the error of a joint is compared
CROWDED = 2.0  # resolutions, within which two lines of a joint trade with each other where the error is no sum of sines


@dataclass(frozen=True)
class HalfDifference:
    """By how much halves of a recording differ, pooled over all lines of all joints: two values alone may agree by chance.

    Attributes
    ----------
    order : float
        Standard deviation of an order, in resolutions of its joint.
    size : float
        Relative standard deviation of the rms of a joint.
    """

    order: float = 0.0
    size: float = 0.0


NO_DIFFERENCE = HalfDifference()


def with_orders(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects; periodic errors with all orders that they may have, and with the parameters of those lines alone that have one."""
    reported = reported_hypothesis(full.evidence)
    peaks: dict[str, list[tuple[OrderPeak, ...]]] = {}
    resolution, middle = dict[str, float](), dict[str, float]()
    for member in reported.catalogued:
        if member.candidate.periodic:
            at = member.candidate.where[0]
            peaks.setdefault(at, []).append(other_peaks(reported, member))
            resolution[at] = resolution_of(reported, member.candidate)
            middle[at] = float(np.mean(covariates(reported.point.linear).value(member.candidate.depends_on)))
    out, spread, whole = [], pooled_spread(effects, resolution), own_errors(full)
    for effect in effects:
        for at in effect.where:
            if f"{at}.order" in effect.parameters and at in peaks:
                parts = next((one for one in effect.found_again if one.at == at and one.disjoint), None)
                effect = stated_orders(effect, at, peaks[at], parts, resolution[at], spread=spread, middle=middle[at], whole=whole.get(at))
        out.append(effect)
    return out


def own_errors(full: ModelFit) -> dict[str, ParameterEstimate]:
    """Joint with a periodic error -> rms over the poses, deg, of all that it turns by as a fast function of its own angle: the lines, and
    what is unmodelled beside them, with the standard deviation that it has for the angles at which it was seen. How much of it is in
    single lines differs between recordings more than the whole does. There is none for a recording of few poses, where something
    unmodelled does not stand at all joints.
    """
    if not full.everywhere:
        return {}
    linear, model = full.geometry_only.linear, full.model
    turned = [
        (m.candidate.where[0], m.candidate.depends_on, candidate_parts(linear, m.candidate, m.hyper), model.coefficients[own])
        for m, own in zip(model.members, model.slices(), strict=True)
        if m.candidate.periodic
    ]
    fast = {m.candidate.where[0] for m in model.members if m.candidate.periodic and m.value >= SLOW}
    joints = {(at, on) for at, on, *_ in turned if at in fast}
    each, (found, _) = zip(full.random, coefficients_of(full.random), strict=True), full.random_effects
    turned += [(g.location, g.depends_on, g.parts, found[own]) for g, own in each if (g.location, g.depends_on) in joints]
    out: dict[tuple[str, str], np.ndarray] = {}
    for at, on, parts, coefficients in turned:
        for part in parts:
            if part.place == "joint" and (at, on) in joints:
                out[at, on] = out.get((at, on), np.zeros(len(part.basis))) + part.basis @ coefficients
    return {at: rms_over_angles(angle := covariates(linear).value(on), in_degrees(fast_part(angle, f))) for (at, on), f in out.items()}


def rms_over_angles(angle: np.ndarray, error: np.ndarray) -> ParameterEstimate:
    """Rms of an error (P,) at angles (P,), and its standard deviation by what parts of these angles differ by (delete-a-group jackknife):
    a recording over other angles gives another one.
    """
    parts = np.array([np.mean(np.square(some)) for some in np.array_split(error[np.argsort(angle)], PARTS_OF_TRAVEL)])
    each = np.sqrt((parts.sum() - parts) / (len(parts) - 1))
    return ParameterEstimate(float(np.sqrt(np.mean(np.square(error)))), float(jackknife(each[:, None])[0]))


def fast_part(angle: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (P,) at angles (P,) without their part of orders below ``SLOW``, by a parabola and half waves over the travel."""
    travel = float(np.ptp(angle))
    half_waves = np.arange(int(SLOW * travel / np.pi) + 1)
    X = np.column_stack([angle, angle**2, np.cos(np.pi * half_waves * (angle - angle.min())[:, None] / max(travel, 1e-9))])
    return values - X @ np.linalg.lstsq(X, values, rcond=None)[0]


def pooled_spread(effects: Sequence[EffectFound], resolution: Mapping[str, float]) -> HalfDifference:
    """The difference over all joints whose periodic errors disjoint parts have. resolution: by joint."""
    orders, sizes = list[float](), list[float]()
    for effect in effects:
        for one in effect.found_again:
            name = f"{one.at}.order"
            if not one.disjoint or name not in effect.parameters or one.at not in resolution:
                continue
            own = [[OrderPeak(float(order), 0.0, 1.0)] for order in effect.parameters[name].components[0]]
            _, lines = seen_in_parts(own, one.values.get(name, ()), resolution[one.at])
            orders += [line[0].sigma / resolution[one.at] for line in lines if line[0].sigma > 0]
            each = rms_in_parts(one, f"{one.at}.amplitude_deg")
            sizes += [relative_spread(each)] if len(each) > 1 else []
    return HalfDifference(*(float(np.sqrt(np.mean(np.square(some)))) if some else 0.0 for some in (orders, sizes)))


def stated_orders(
    effect: EffectFound,
    at: str,
    others: Sequence[Sequence[OrderPeak]],
    parts: FoundAgain | None,
    resolution: float,
    spread: HalfDifference = NO_DIFFERENCE,
    middle: float = 0.0,
    whole: ParameterEstimate | None = None,
) -> EffectFound:
    """The effect with the orders of one joint.

    Parameters
    ----------
    others
        Further peaks of the posterior of each line.
    parts
        What disjoint parts of the recording have, where there are such.
    resolution
        Distance of two orders that differ by one period over the travel.
    spread
        By how much halves differ.
    middle
        Mean of the angle, rad: an order is turned about it, and the phase at zero with it.
    whole
        Rms of the fast error of the joint by its own angle, deg; None for that of its lines.
    """
    orders, sigmas = (np.array(x) for x in effect.parameters[f"{at}.order"].components)
    lines = []
    for j, (order, sigma) in enumerate(zip(orders, sigmas, strict=True)):
        further = others[j] if j < len(others) else ()
        lines.append([OrderPeak(float(order), max(float(sigma), spread.order * resolution), 1.0), *further])
    in_parts = np.ones(len(orders), int)
    if parts is not None:
        in_parts, lines = seen_in_parts(lines, parts.values.get(f"{at}.order", ()), resolution)
    least = 1 if parts is None else parts.parts
    few_and_sharp = [len(line) <= MOST_PEAKS and all(K * peak.sigma <= SHARPEST for peak in line) for line in lines]
    known = [count >= least and sure for count, sure in zip(in_parts, few_and_sharp, strict=True)]
    if parts is not None:
        apart = np.abs(orders[:, None] - orders) + np.diag(np.full(len(orders), np.inf))
        alone = (apart.min(axis=1) > CROWDED * resolution) & (orders >= resolution)  # a period and more was seen
        known = [sure and bool(one) for sure, one in zip(known, alone, strict=True)]
    listed = [
        PossibleOrder(at, number, peak.order, peak.sigma, peak.odds, determined)
        for number, (line, determined) in enumerate(zip(lines, known, strict=True), 1)
        for peak in line
    ]
    single = [determined and len(line) == 1 for determined, line in zip(known, lines, strict=True)]
    total = np.array([line[0].sigma for line in lines])
    turned = in_degrees(np.sqrt(np.maximum(total**2 - sigmas**2, 0.0)) * abs(middle))
    parameters = of_lines(effect.parameters, at, (total, turned), single, parts, spread, whole)
    return replace(effect, parameters=parameters, orders=(*effect.orders, *listed))


def seen_in_parts(
    lines: Sequence[Sequence[OrderPeak]], parts: Sequence[ParameterEstimate], resolution: float
) -> tuple[np.ndarray, list[list[OrderPeak]]]:
    """In how many parts (k,) each line has an order, and the peaks of each with those that parts have in place of the reported one: as
    probable as there are parts for each.
    """
    own = np.array([line[0].order for line in lines])
    out, count = [list(line) for line in lines], np.zeros(len(own), int)
    same: list[list[float]] = [[] for _ in own]
    for stated in parts:
        orders, sigmas = (np.array(x) for x in stated.components)
        apart = np.abs(own[:, None] - orders)
        for j, k in zip(*linear_sum_assignment(apart), strict=True):
            if apart[j, k] > max(ALIASES, resolution):
                continue
            count[j] += 1
            if apart[j, k] <= max(LEAST_APART, ONE_PEAK * resolution):
                same[j].append(float(orders[k]))
            elif not any(abs(peak.order - orders[k]) <= LEAST_APART for peak in out[j]):
                out[j].append(OrderPeak(float(orders[k]), float(sigmas[k]), 1.0))
            else:
                out[j] = [replace(p, odds=1.0) if abs(p.order - orders[k]) <= LEAST_APART else p for p in out[j]]
    for line, found in zip(out, same, strict=True):
        if len(found) > 1:
            line[0] = replace(line[0], sigma=max(line[0].sigma, float(jackknife(np.array(found)[:, None])[0])))
    return count, out


def of_lines(
    parameters: Mapping[str, ParameterEstimate],
    at: str,
    sigmas: tuple[np.ndarray, np.ndarray],
    single: Sequence[bool],
    parts: FoundAgain | None,
    spread: HalfDifference = NO_DIFFERENCE,
    whole: ParameterEstimate | None = None,
) -> dict[str, ParameterEstimate]:
    """The parameters without the lines of a joint that have more than one order. If lines were left out, or are not the whole error, the
    rms of all together is added, which their orders do not change. sigmas: (k,) of each order, and (k,) deg that it adds to the
    uncertainty of each phase.
    """
    columns = {name: np.array(parameters[f"{at}.{name}"].components) for name in LINE if f"{at}.{name}" in parameters}
    chosen = np.flatnonzero(single)
    out = {}
    for key, stated in parameters.items():
        where, _, name = key.rpartition(".")
        if where != at or name not in columns:
            out[key] = stated
            continue
        values, stds = columns[name]
        if name == "order":
            stds = np.maximum(stds, sigmas[0])
        elif name == "phase_deg":
            stds = np.hypot(stds, sigmas[1])
        elif name == "amplitude_deg":
            stds = np.maximum(stds, spread.size * values)
        if len(chosen) == 1:
            out[key] = ParameterEstimate(float(values[chosen[0]]), float(stds[chosen[0]]))
        elif len(chosen):
            out[key] = ParameterEstimate(tuple(values[chosen].tolist()), tuple(stds[chosen].tolist()))
    if not (all(single) and whole is None) and "amplitude_deg" in columns:
        values, stds = columns["amplitude_deg"]
        out[f"{at}.{RMS}"] = rms_of_lines(values, stds, rms_in_parts(parts, f"{at}.amplitude_deg"), spread, whole)
    return out


def rms_in_parts(parts: FoundAgain | None, name: str) -> np.ndarray:
    """(n,) rms of all lines of a joint in each part, deg; name: of the amplitudes."""
    return np.array([] if parts is None else [np.sqrt(np.sum(np.square(p.components[0])) / 2) for p in parts.values.get(name, ())])


def rms_of_lines(
    values: np.ndarray, stds: np.ndarray, each: np.ndarray, spread: HalfDifference, whole: ParameterEstimate | None = None
) -> ParameterEstimate:
    """Rms of the error of a joint by its own angle, deg: ``whole``, or that of its lines by their amplitudes (k,). It is no surer, relative
    to its size, than the lines are and than disjoint parts differ by. each: (n,) of the lines of the parts.
    """
    rms = float(np.sqrt(values @ values / 2))
    relative = max(float(np.sqrt(np.sum((values * stds) ** 2)) / (2 * max(rms, 1e-300) ** 2)), spread.size)
    if len(each) > 1:
        relative = max(relative, float(jackknife(each[:, None])[0]) / max(rms, 1e-300))
    if whole is None:
        return ParameterEstimate(rms, relative * rms)
    (size,), (of_angles,) = whole.components
    return ParameterEstimate(size, float(np.hypot(relative * size, of_angles)))
