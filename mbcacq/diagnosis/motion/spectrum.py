"""Periodic components of a residual in a joint's own angle, by a Fourier transform of the residual summed in fine steps of angle."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals
from mbcacq.effects.motion_periods import OrderRange, periodic_component, range_of_orders


def periodic_candidates(
    group: ChannelGroup, runs: tuple[MotionSignals, ...], joint: int, residual: np.ndarray, training: np.ndarray
) -> list[Candidate]:
    """Candidates for the strongest spectral lines of a residual (Ttot,): the strongest, the strongest above its background, and those
    near one and two periods per motor turn. training: (Ttot,) which samples take part."""
    effect = catalogue.periodic_in(group.name)
    limits = None if effect is None else range_of_orders(effect[1].lowest_order, runs, joint)
    if effect is None or limits is None:
        return []
    q = np.concatenate([run.q[:, joint] for run in runs])
    observed = (float(q[training > 0].min()), float(q[training > 0].max()))
    power, orders = _power(q, residual * training, limits, NUMBERS.spectrum_oversampling)
    if len(power) < 3:
        return []
    tried = (limits.highest - limits.lowest) / limits.spacing
    found = [(float(orders[i]), tried) for i in _strongest(power, NUMBERS.background_orders)]
    ratio = runs[0].gear_ratio
    motor_orders = [] if ratio is None else [turns * abs(float(ratio[joint])) for turns in (1, 2)]
    for motor_order in motor_orders:
        near = np.flatnonzero(np.abs(orders - motor_order) <= limits.spacing)
        if len(near):
            found.append((float(orders[near[np.argmax(power[near])]]), NUMBERS.motor_order_trials))
    return [periodic_component(effect, joint, order, limits.spacing / 2, trials, observed) for order, trials in found]


def _power(q: np.ndarray, residual: np.ndarray, limits: OrderRange, oversampling: int) -> tuple[np.ndarray, np.ndarray]:
    """Power of a residual (Ttot,) over the angle q, and its orders, both within the limits."""
    step = 2 * np.pi / (limits.highest * oversampling)
    bins = np.round((q - float(q.min())) / step).astype(int)
    length = int(2 ** np.ceil(np.log2(max(oversampling * 2 * np.pi / limits.spacing / step, bins.max() + 2))))
    power = np.abs(np.fft.rfft(np.bincount(bins, residual, minlength=length), length)) ** 2
    orders = 2 * np.pi * np.arange(len(power)) / (length * step)
    inside = (orders >= limits.lowest) & (orders <= limits.highest)
    return power[inside], orders[inside]


def _strongest(power: np.ndarray, background: int) -> set[int]:
    """Positions of the strongest line and of the strongest one above the geometric mean of its ``background`` neighbours."""
    picks = {int(np.argmax(power))}
    if len(power) > 2 * background:
        kernel = np.ones(background) / background
        ground = np.exp(np.convolve(np.pad(np.log(power + 1e-300), background // 2, mode="edge"), kernel, mode="valid"))
        picks.add(int(np.argmax(power / ground[: len(power)])))
    return picks
