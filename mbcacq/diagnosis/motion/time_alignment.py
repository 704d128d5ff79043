"""A channel that was sampled late is put right in time, so that every other effect is seen at the instant at which it acted.

A column for the delay beside the others would do for a slow motion only: ripple, waves and friction are late with the channel too, and a
recorded torque, differentiated, carries noise that shrinks its own coefficient. So the recording is moved, and the slope by which what
is left of the delay is read is that of the simulation, which has no noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from mbcacq.effects.motion.effect import ChannelGroup, MotionSignals

if TYPE_CHECKING:
    from mbcacq.diagnosis.motion.forward_selection import ForwardSelection, SelectedEffect

ROUNDS = 6
LONGEST_S = 0.05  # a longer delay of a channel is not credible
SETTLED_S = 1e-8


def lateness(group: ChannelGroup, run: MotionSignals, k: int, place: int, delay: float) -> np.ndarray:
    """What moving the recorded channel forward by ``delay`` s adds to the mismatch (T,) of run number k and the joint at ``place``."""
    signal = group.signal[k][:, place]
    if delay == 0.0:
        return np.zeros(len(signal))
    time = run.step_s * np.arange(len(signal))
    return CubicSpline(time, signal)(np.clip(time + delay, 0.0, time[-1])) - signal


def settle(selection: ForwardSelection) -> None:
    """Find the delay of the channel, if one was taken, by Gauss-Newton; all coefficients are refitted."""
    late = next((t for t in selection.taken if t.candidate.tuned), None)
    if late is None:
        return
    ledger = selection.ledger
    for _ in range(ROUNDS):
        x = fitted(selection)
        position = {int(c): i for i, c in enumerate(selection.chosen())}
        _slope(selection, late, x, position)
        step = float(fitted(selection)[position[int(late.variant.ids[0])]])
        delay = float(np.clip(late.variant.hyper + step, -LONGEST_S, LONGEST_S))
        moved, late.variant.hyper = abs(delay - late.variant.hyper), delay
        ledger.retime(delay)
        if moved < SETTLED_S:
            return


def fitted(selection: ForwardSelection) -> np.ndarray:
    """Coefficients of all that stands."""
    chosen = selection.chosen()
    return selection.ledger.solve(selection.ledger.normal(selection.weights(chosen)), chosen)


def _slope(selection: ForwardSelection, late: SelectedEffect, x: np.ndarray, position: dict[int, int]) -> None:
    """The column of the delay: for a torque, minus the rate of all that is simulated."""
    if selection.group.name != "tau":
        return
    columns = []
    for place, joint in enumerate(selection.group.joints):
        parts = []
        for k, run in enumerate(selection.runs):
            torque = run.rigid[:, joint] + selection.simulated(place, k, x, position, (late.candidate.name,), rotors=True)
            parts.append(-np.gradient(torque, run.step_s))
        columns.append(np.concatenate(parts)[:, None])
    selection.ledger.replace(late.variant.ids, list(range(len(columns))), columns)
