"""Periods of a residual in a joint's own angle, by one transform: the residual is summed in fine steps of angle first."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals
from mbcacq.effects.motion.torque_ripple import range_of_orders, wave

FINER = 8  # steps of angle per shortest period, and steps of order per distinguishable one
NEIGHBOURS = 61  # orders about a line that say how high the ground is there


def lines(
    group: ChannelGroup, runs: tuple[MotionSignals, ...], joint: int, left: np.ndarray, training: np.ndarray
) -> list[MotionCandidate]:
    """Candidates for the strongest waves in ``left`` (Ttot,): strongest of all, strongest above its surroundings, at motor orders.

    training: (Ttot,) which samples take part.
    """
    limits = range_of_orders(group, runs, joint)
    if limits is None:
        return []
    lowest, highest, spacing = limits
    step = 2 * np.pi / (highest * FINER)
    low = min(float(run.q[:, joint].min()) for run in runs)
    q = np.concatenate([run.q[:, joint] for run in runs])
    seen = (float(q[training > 0].min()), float(q[training > 0].max()))
    bins = np.round((q - low) / step).astype(int)
    length = int(2 ** np.ceil(np.log2(max(FINER * 2 * np.pi / spacing / step, bins.max() + 2))))
    power = np.abs(np.fft.rfft(np.bincount(bins, left * training, minlength=length), length)) ** 2
    orders = 2 * np.pi * np.arange(len(power)) / (length * step)
    inside = (orders >= lowest) & (orders <= highest)
    if inside.sum() < 3:
        return []
    power, orders = power[inside], orders[inside]
    tried = (highest - lowest) / spacing
    picks = {int(np.argmax(power))}
    if len(power) > 2 * NEIGHBOURS:
        kernel = np.ones(NEIGHBOURS) / NEIGHBOURS
        ground = np.exp(np.convolve(np.pad(np.log(power + 1e-300), NEIGHBOURS // 2, mode="edge"), kernel, mode="valid"))
        picks.add(int(np.argmax(power / ground[: len(power)])))
    ratio = None if runs[0].gear_ratio is None else abs(float(runs[0].gear_ratio[joint]))
    found = [(float(orders[i]), tried) for i in picks]
    for turns in (1, 2) if ratio is not None else ():
        near = np.flatnonzero(np.abs(orders - turns * ratio) <= spacing)
        if len(near):
            found.append((float(orders[near[np.argmax(power[near])]]), 4.0))
    return [wave(group, joint, order, spacing / 2, trials, seen) for order, trials in found]
