"""Continuous hyper-parameters (an order, a time constant, a speed) estimated with the coefficients, by Gauss-Newton.

A channel that was sampled late is corrected in time, so that every other effect appears at the instant at which it acted. A column for the
delay among the others would serve for a slow motion only. Periodic components and friction are late with the channel too, and a recorded
torque, differentiated, carries noise that shrinks its own coefficient. So the recording is shifted, and the slope by which the remaining
delay is estimated is that of the simulation, which has no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate


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


MOST_WINDOWS = 3  # of a periodic component's order, each as wide as two distinguishable orders
SMALLEST_HYPER = 1e-9  # of a numerical derivative's relative step


def estimate_hyperparameters(model: MotionModel) -> None:
    """Gauss-Newton on the continuous hyper-parameters, all coefficients refitted, within the spacing of what was tried."""
    estimate_delay(model)
    update_load(model)
    for _ in range(MOST_WINDOWS):
        if not _improved_orders(model):
            break
    if continuous_effects(model):
        estimate_delay(model)
        update_load(model)


def _improved_orders(model: MotionModel) -> bool:
    """Gauss-Newton within one window. Returns whether the order of a periodic component is at the end of its window: a spectral line of a
    short travel is broad, and its top may be beyond.
    """
    free = continuous_effects(model)
    if not free:
        return False
    bounds = [_neighbours(effect) for effect in free]
    store, best = model.store, None
    for _ in range(NUMBERS.hyper_rounds):
        chosen = model.chosen()
        weights = model.weights(chosen)
        x = store.solve(store.normal(weights), chosen)
        deviance = float(np.log(np.maximum(store.errors(chosen, x), 1e-300)) @ store.count.sum(axis=0))
        if best is not None and deviance > best:
            break
        best = deviance
        mark = len(store.prior)
        ids = np.concatenate([chosen, *add_derivatives(model, free, chosen, x)]).astype(int)
        steps = store.solve(store.normal(weights), ids)[len(chosen) :]
        store.forget(mark)
        for i, (step, (low, high)) in enumerate(zip(steps, bounds, strict=True)):
            hyper = float(np.clip(free[i].value + step, low, high))
            free[i] = _moved(model, free[i], hyper)
    return any(_is_order(e) and e.value in ends for e, ends in zip(free, bounds, strict=True))


def _moved(model: MotionModel, effect: Member, hyper: float) -> Member:
    """A selected effect at another value. The columns of a value that is tried are the pool's and stay; those of any other are its own and
    are overwritten, or the columns that nobody needs any more would slow down all that follows.
    """
    candidate = effect.candidate
    assert candidate.hyper is not None
    if effect.hyper in candidate.hyper.values:
        return model.moved(effect, hyper, model.add(candidate, hyper))
    columns = [model.columns(candidate, joint, hyper) for joint in candidate.rows.joints]
    model.store.replace(effect.columns, model.joint_indices(candidate), columns)
    return model.moved(effect, hyper, effect.columns)


def _is_order(effect: Member) -> bool:
    """The values that are tried are a few about one that was found among many."""
    hyper = effect.candidate.hyper
    return hyper is not None and hyper.independent > len(hyper.values)


def continuous_effects(model: MotionModel) -> list[Member]:
    """The selected effects whose hyper-parameter is estimated."""
    return [e for e in model.selected if e.candidate.hyper is not None and e.candidate.hyper.refine]


def uncertain_effects(model: MotionModel) -> list[Member]:
    """The selected effects whose hyper-parameter makes their coefficients uncertain: it is estimated, or the nearest of those tried."""
    return [e for e in model.selected if (hyper := e.candidate.hyper) is not None and (hyper.refine or (hyper.name and e.hyper))]


def add_derivatives(model: MotionModel, effects: Sequence[Member], chosen: np.ndarray, x: np.ndarray) -> list[np.ndarray]:
    """For each of these effects add the column d(effect)/d(hyper) to the store. Returns their numbers.

    x: coefficients of the columns ``chosen``.
    """
    position, out = model.store.positions(chosen), []
    for effect in effects:
        c = x[position[effect.columns]]
        h = effect.value
        d = NUMBERS.hyper_step * max(abs(h), SMALLEST_HYPER)
        columns = [_derivative(model, effect.candidate, joint, h, d, c) for joint in effect.candidate.rows.joints]
        out.append(model.store.add(model.joint_indices(effect.candidate), columns))
    return out


def _derivative(model: MotionModel, candidate: Candidate, joint: int, h: float, d: float, c: np.ndarray) -> np.ndarray:
    """(Ttot, 1) by a central difference of step d about the value h; c: coefficients (k,)."""
    rates = [(candidate.rows.columns(run, joint, h + d) - candidate.rows.columns(run, joint, h - d)) @ c / (2 * d) for run in model.runs]
    return np.concatenate(rates)[:, None]


def update_load(model: MotionModel) -> None:
    """Let effects that follow the load see it as it is now known, no longer as the arm is described."""
    if not any(effect.candidate.rows.follows_load for effect in model.selected):
        return
    x = model.coefficients()
    motor_side = [e.candidate.name for e in model.selected if catalogue.declaration(e.candidate.name).motor_side]
    runs = []
    for k, run in enumerate(model.runs):
        assert run.rigid is not None, "effects that follow the load are offered for torques only"
        load = run.rigid.copy()
        for j, joint in enumerate(model.group.joints):
            load[:, joint] += model.simulated(j, k, x, without=motor_side, rotors=False)
        runs.append(replace(run, load=load))
    model.set_runs(tuple(runs))


def _neighbours(effect: Member) -> tuple[float, float]:
    """The values tried next to the present one; beyond the largest, one more step. An order has no first or last value."""
    assert effect.candidate.hyper is not None
    values = np.sort(effect.candidate.hyper.values)
    if _is_order(effect):
        step = float(values[1] - values[0])
        return effect.value - step, effect.value + step
    k = int(np.argmin(np.abs(values - effect.value)))
    low = values[k - 1] if k else values[0]
    high = values[k + 1] if k + 1 < len(values) else 2 * values[-1] - values[-2]
    return float(low), float(high)
