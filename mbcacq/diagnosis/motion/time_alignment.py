"""A channel that was sampled late is corrected in time, so that every other effect appears at the instant at which it acted.

A column for the delay among the others would serve for a slow motion only. Periodic components and friction are late with the channel too,
and a recorded torque, differentiated, carries noise that shrinks its own coefficient. So the recording is shifted, and the slope by which
the remaining delay is estimated is that of the simulation, which has no noise.
"""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.search.effect_set import Member


def estimate_delay(model: MotionModel) -> None:
    """Find the delay of the channel, if that effect was selected, by Gauss-Newton; all coefficients are refitted."""
    late = next((e for e in model.selected if e.candidate.rows.channel_delay), None)
    if late is None:
        return
    for _ in range(NUMBERS.delay_rounds):
        x = model.coefficients()
        first = int(np.flatnonzero(model.chosen() == late.columns[0])[0])
        _update_slope(model, late, x)
        before, step = late.value, float(model.coefficients()[first])
        delay = float(np.clip(before + step, -NUMBERS.longest_delay_s, NUMBERS.longest_delay_s))
        late = model.moved(late, delay, late.columns)
        model.store.correct_delay(delay)
        if abs(delay - before) < NUMBERS.delay_tolerance_s:
            return


def _update_slope(model: MotionModel, late: Member, x: np.ndarray) -> None:
    """The column of the delay: for a torque, minus the rate of all that is simulated."""
    if model.group.name != "tau":
        return
    columns = []
    for j, joint in enumerate(model.group.joints):
        rates = []
        for k, run in enumerate(model.runs):
            assert run.rigid is not None, "a torque is compared with that of the rigid arm"
            torque = run.rigid[:, joint] + model.simulated(j, k, x, without=(late.candidate.name,), rotors=True)
            rates.append(-np.gradient(torque, run.step_s))
        columns.append(np.concatenate(rates)[:, None])
    model.store.replace(late.columns, list(range(len(columns))), columns)
