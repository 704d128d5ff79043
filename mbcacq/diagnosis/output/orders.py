"""Orders of periodic errors as they are stated: one, several with the odds of each, or not determined.

What repeats between recordings of one arm is that a joint errs periodically, and how much. A line of its spectrum is stated where the
posterior over all peaks has few of them, each of them sharp, and where disjoint parts of the recording have it as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from mbcacq.diagnosis.effect_found import EffectFound, FoundAgain, PossibleOrder
from mbcacq.diagnosis.evidence.order_posterior import LEAST_APART, OrderPeak, other_peaks, resolution_of
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.validation.found_again import jackknife
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.quantities import K

MOST_PEAKS = 3  # that are stated with their odds; more say that the order is not determined
SHARPEST = 0.5  # expanded uncertainty from which an order is not determined: it does not tell one whole number from the next
ONE_PEAK = 0.4  # of the resolution, within which orders of two parts are one
ALIASES = 2.0  # orders, or one resolution, within which what parts have is the same line
LINE = ("order", "amplitude_deg", "phase_deg")  # parameters of which a joint has one component for each line
RMS = "rms_deg"  # of the periodic error of a joint, all lines together


def with_orders(full: ModelFit, effects: Sequence[EffectFound]) -> list[EffectFound]:
    """The effects; periodic errors with all orders that they may have, and with the parameters of those lines alone that have one."""
    reported = reported_hypothesis(full.evidence)
    peaks: dict[str, list[tuple[OrderPeak, ...]]] = {}
    resolution: dict[str, float] = {}
    for member in reported.catalogued:
        if member.candidate.periodic:
            at = member.candidate.where[0]
            peaks.setdefault(at, []).append(other_peaks(reported, member))
            resolution[at] = resolution_of(reported, member.candidate)
    out = []
    for effect in effects:
        for at in effect.where:
            if f"{at}.order" in effect.parameters and at in peaks:
                parts = next((one for one in effect.found_again if one.at == at and one.disjoint), None)
                effect = stated_orders(effect, at, peaks[at], parts, resolution[at])
        out.append(effect)
    return out


def stated_orders(
    effect: EffectFound, at: str, others: Sequence[Sequence[OrderPeak]], parts: FoundAgain | None, resolution: float
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
    """
    orders, sigmas = (np.array(x) for x in effect.parameters[f"{at}.order"].components)
    lines = []
    for j, (order, sigma) in enumerate(zip(orders, sigmas, strict=True)):
        further = others[j] if j < len(others) else ()
        lines.append([OrderPeak(float(order), float(sigma), 1.0), *further])
    in_parts = np.ones(len(orders), int)
    if parts is not None:
        in_parts, lines = seen_in_parts(lines, parts.values.get(f"{at}.order", ()), resolution)
    least = 1 if parts is None else parts.parts
    known = [count >= least and is_determined(line) for count, line in zip(in_parts, lines, strict=True)]
    listed = [
        PossibleOrder(at, number, peak.order, peak.sigma, peak.odds, determined)
        for number, (line, determined) in enumerate(zip(lines, known, strict=True), 1)
        for peak in line
    ]
    single = [determined and len(line) == 1 for determined, line in zip(known, lines, strict=True)]
    parameters = of_lines(effect.parameters, at, [line[0].sigma for line in lines], single, parts)
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


def is_determined(line: Sequence[OrderPeak]) -> bool:
    """Whether a few sharp peaks are all that the order of a line may be."""
    return len(line) <= MOST_PEAKS and all(K * peak.sigma <= SHARPEST for peak in line)


def of_lines(
    parameters: Mapping[str, ParameterEstimate], at: str, sigmas: Sequence[float], single: Sequence[bool], parts: FoundAgain | None
) -> dict[str, ParameterEstimate]:
    """The parameters with those lines of a joint alone that have a single order; where others are left out, the rms of all lines together,
    which is determined whatever their orders.
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
        stds = np.maximum(stds, sigmas) if name == "order" else stds
        if len(chosen) == 1:
            out[key] = ParameterEstimate(float(values[chosen[0]]), float(stds[chosen[0]]))
        elif len(chosen):
            out[key] = ParameterEstimate(tuple(values[chosen].tolist()), tuple(stds[chosen].tolist()))
    if not all(single) and "amplitude_deg" in columns:
        values, stds = columns["amplitude_deg"]
        out[f"{at}.{RMS}"] = rms_of_lines(values, stds, parts, f"{at}.amplitude_deg")
    return out


def rms_of_lines(values: np.ndarray, stds: np.ndarray, parts: FoundAgain | None, name: str) -> ParameterEstimate:
    """Rms over a whole period of all lines of a joint, deg, by their amplitudes (k,); no surer than disjoint parts differ by."""
    rms = float(np.sqrt(values @ values / 2))
    std = float(np.sqrt(np.sum((values * stds) ** 2)) / (2 * max(rms, 1e-300)))
    each = [] if parts is None else [np.sqrt(np.sum(np.square(p.components[0])) / 2) for p in parts.values.get(name, ())]
    return ParameterEstimate(rms, max(std, float(jackknife(np.array(each)[:, None])[0])) if len(each) > 1 else std)
