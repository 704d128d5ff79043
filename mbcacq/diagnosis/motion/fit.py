"""The selected effects fitted to all data: parameters with uncertainty, continuous hyper-parameters among them.

The residuals, the channels over time, and the torque that passes the gears follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import savgol_filter

from mbcacq.diagnosis.effect_found import EffectFound, MotionStep
from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.between_sets import BetweenSets
from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.motion.candidate_pool import CandidatePool
from mbcacq.diagnosis.motion.effect_selection import EffectSelection, Judged
from mbcacq.diagnosis.motion.hyperparameters import add_derivatives, estimate_hyperparameters, uncertain_effects
from mbcacq.diagnosis.motion.inertial_consistency import bodies, consistent_coefficients
from mbcacq.diagnosis.motion.load_error import load_alternatives, load_error
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.noise import covariance
from mbcacq.diagnosis.motion.normal_store import shift_difference
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.result import ChannelFit
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate, Parameters, joined_parameters
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.model.trajectory import Trajectory
from mbcacq.quantities import K

# Relative distance from the first or last value tried within which a hyper-parameter is at that bound.
BOUND = 1e-6
ByRun = list[list[np.ndarray]]  # (T,) by joint of the group and run


@dataclass(frozen=True)
class FittedEffect:
    """One effect of the catalogue at one location, with all its forms.

    found: as it is reported, but for what it removes from held-out data. gain: (J,) reduction of the held-out mean square. contributions:
    (T,) by joint of the group and run, what it adds to the mismatch.
    """

    candidate: Candidate[MotionRows]
    found: EffectFound
    gain: np.ndarray
    contributions: ByRun


@dataclass(frozen=True)
class MotionFit:
    """A group of channels with the effects found.

    Attributes
    ----------
    residual_before, residual_after : ByRun
        Residuals with the base alone, and with all effects.
    used : ByRun
        The samples that count.
    links : ByRun
        Torque by which the links differ from their description, as fitted.
    load_error : list[ndarray]
        (T, J, r) by run, what independent errors of standard deviation 1 change of the torque that passes the gears.
    sets : EvidenceFit or None
        Sets of effects that were compared.
    load_alternatives : list[NotSeparable]
        Other loads that they do not exclude.
    inertial : ndarray or None
        (b, 10) parameters of the links and of the tool that was found (``geometry.dynamics.INERTIAL``), None for another channel.
    held_out_before, held_out_after, train_before, train_after : ndarray
        (J,) mean squares.
    floor : ndarray
        (J,) standard deviation of the channels' noise.
    """

    group: ChannelGroup
    effects: list[FittedEffect]
    residual_before: ByRun
    residual_after: ByRun
    used: ByRun
    held_out_before: np.ndarray
    held_out_after: np.ndarray
    train_before: np.ndarray
    train_after: np.ndarray
    floor: np.ndarray
    split: str
    links: ByRun
    load_error: list[np.ndarray]
    sets: EvidenceFit | None = None
    inertial: np.ndarray | None = None
    load_alternatives: list[NotSeparable] = field(default_factory=list)


def fit_selected(selection: EffectSelection) -> MotionFit:
    """Fit what was selected to all data that take part."""
    model = selection.model
    store, joints = model.store, range(len(model.group.joints))
    estimate_hyperparameters(model)
    residual_before, train_before = _base_alone(model)
    chosen = model.chosen()
    weights = model.weights(chosen)
    x = consistent_coefficients(model, weights, chosen, store.solve(store.normal(weights), chosen))
    spread = _covariance(model, weights, chosen, x, selection.pool)
    n = np.maximum(store.count.sum(axis=0), 1.0)
    found = bodies(model, chosen)
    effects = _averaged(_effects(model, selection.judged, x, spread), selection.sets)
    residuals, used = (residual_before, _residuals(model, chosen, x)), [[use[:, j] for use in model.group.use] for j in joints]
    held = selection.start, model.held_out_mean_square(chosen, model.fold_normals(weights))
    links = [[model.of_links(j, run, x) for run in range(len(model.runs))] for j in joints]
    trained, error = (train_before / n, store.errors(chosen, x) / n), load_error(model, weights)
    fit = MotionFit(model.group, effects, *residuals, used, *held, *trained, model.floor, split=store.split, links=links, load_error=error)
    alternatives = load_alternatives(model, selection.pool) if store.whole else []
    selection.pool.forget_step()
    inertial = None if found is None else found.parameters(x)
    return replace(fit, sets=selection.sets, inertial=inertial, load_alternatives=alternatives)


def _base_alone(model: MotionModel) -> tuple[ByRun, np.ndarray]:
    """Residuals and squared errors (J,) of the base, with the channel as it was recorded."""
    store, delay = model.store, model.store.delay
    store.correct_delay(0.0)
    base = np.setdiff1d(store.base, model.load_error, assume_unique=True)
    x = store.solve(store.normal(model.weights(base)), base)
    out = _residuals(model, base, x), store.errors(base, x)
    store.correct_delay(delay)
    return out


def _covariance(model: MotionModel, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray, pool: CandidatePool) -> np.ndarray:
    """Covariance of the coefficients x, then of the hyper-parameters, all together; refinements that these recordings cannot test may be
    there as well.
    """
    store, uncertain = model.store, uncertain_effects(model)
    if not store.whole:  # with a part held out only the prediction is used
        return np.zeros((len(x) + len(uncertain),) * 2)
    further = np.concatenate([chosen, *add_derivatives(model, uncertain, chosen, x), *pool.untested()]).astype(int)
    return covariance(store, weights, further, np.concatenate([x, np.zeros(len(further) - len(x))]), NUMBERS.correlation_s)


def _residuals(model: MotionModel, chosen: np.ndarray, x: np.ndarray) -> ByRun:
    out = []
    for j in range(len(model.group.joints)):
        residual = model.store.residual(j, chosen, x)
        out.append([residual[model.store.slices(run)] for run in range(len(model.runs))])
    return out


def _effects(model: MotionModel, judged: Mapping[tuple, Judged], x: np.ndarray, spread: np.ndarray) -> list[FittedEffect]:
    chosen = model.chosen()
    position, uncertain = model.store.positions(chosen), uncertain_effects(model)
    out: dict[tuple, FittedEffect] = {}
    for effect in model.selected:
        hyper = [len(chosen) + k for k, e in enumerate(uncertain) if e is effect]
        hyper_std = float(np.sqrt(max(spread[hyper[0], hyper[0]], 0.0))) if hyper else 0.0
        at = position[effect.columns]
        fitted = _fitted(model, effect, judged.get(effect.candidate.form, Judged()), x[at], spread[np.ix_(at, at)], hyper_std)
        known = out.get(effect.candidate.location)
        out[effect.candidate.location] = fitted if known is None else _joined(known, fitted)
    return list(out.values())


def _averaged(effects: list[FittedEffect], sets: EvidenceFit | None) -> list[FittedEffect]:
    """The effects with the parameters as all sets state them that are not excluded, but for hyper-parameters that these do not determine:
    a time constant has a sign.
    """
    if sets is None or not sets.significant:
        return effects
    between, out = BetweenSets.of(sets), list[FittedEffect]()
    for e in effects:
        parameters, hyper = dict(between.averaged([e.candidate.label], e.found.parameters)), e.candidate.hyper
        if hyper is not None and not hyper.from_none and hyper.name in parameters:
            values, stds = parameters[hyper.name].components
            if any(K * std >= value for value, std in zip(values, stds, strict=True)):
                del parameters[hyper.name]
        out.append(replace(e, found=replace(e.found, parameters=parameters)))
    return out


def _fitted(model: MotionModel, effect: Member, judged: Judged, c: np.ndarray, v: np.ndarray, hyper_std: float) -> FittedEffect:
    candidate = effect.candidate
    parameters = dict(candidate.parameters(c, v, effect.hyper, hyper_std))
    notes = []
    if candidate.hyper is not None and at_bound(effect):
        del parameters[candidate.hyper.name]
        tried = np.sort(candidate.hyper.values)
        limits = f"{tried[0]:.3g} to {tried[-1]:.3g}"
        notes = [f"{candidate.hyper.name} is not determined: the best fit is at the end of what was tried, {limits}"]
    steps = (_step(model.group, candidate, parameters, judged),) if len(judged.before) else ()
    found = EffectFound(name=candidate.name, where=candidate.where, parameters=parameters, p_value=judged.p_value, held_out_gain=0.0)
    found = replace(found, depends_on=candidate.depends_on, channel=model.group.name, steps=steps, notes=tuple(notes))
    found = replace(found, alternatives=tuple(judged.alternatives))
    contributions = _delayed(model, effect, c) if candidate.rows.channel_delay else _contribution(model, effect, c)
    return FittedEffect(candidate, found, judged.before - judged.after, contributions)


def at_bound(member: Member) -> bool:
    """The reported hyper-parameter is at the first or last value that was tried."""
    tried, hyper = member.candidate.hyper, member.hyper
    if tried is None or not tried.name or hyper is None:
        return False
    first, last = float(np.min(tried.values)), float(np.max(tried.values))
    return hyper >= last * (1.0 - BOUND) or (not tried.from_none and hyper <= first * (1.0 + BOUND))


def _step(group: ChannelGroup, candidate: Candidate, parameters: Parameters, judged: Judged) -> MotionStep:
    """The held-out errors of the joints on which an effect acts, without it and with it."""
    before, after = (
        {group.axes[joint]: group.scale * float(np.sqrt(square[group.index(joint)])) for joint in candidate.rows.joints}
        for square in (judged.before, judged.after)
    )
    return MotionStep(tuple(parameters), before, after)


def _joined(first: FittedEffect, other: FittedEffect) -> FittedEffect:
    """An effect with one form more."""
    one, more = first.found, other.found
    parameters, p_value = joined_parameters((one.parameters, more.parameters)), min(one.p_value, more.p_value)
    found = replace(one, parameters=parameters, p_value=p_value, steps=(*one.steps, *more.steps), notes=(*one.notes, *more.notes))
    added = zip(first.contributions, other.contributions, strict=True)
    contributions = [[a + b for a, b in zip(p, q, strict=True)] for p, q in added]
    return FittedEffect(first.candidate, found, first.gain + other.gain, contributions)


def _contribution(model: MotionModel, effect: Member, c: np.ndarray) -> ByRun:
    return [[model.columns_of(effect, j, run) @ c for run in range(len(model.runs))] for j in range(len(model.group.joints))]


def _delayed(model: MotionModel, effect: Member, c: np.ndarray) -> ByRun:
    delay, signals = effect.value + float(c[0]), model.group.signal
    return [
        [-shift_difference(signals[k][:, j], run.step_s, delay) for k, run in enumerate(model.runs)] for j in range(len(model.group.joints))
    ]


def with_load(runs: tuple[MotionSignals, ...], torque: MotionFit) -> tuple[MotionSignals, ...]:
    """The runs with the torque that passes the gears, joint by joint, and its error.

    Torque of the arm as found, without what acts on the motor side, if the torque is explained; otherwise the drive's torque less its
    friction, which is wrong by a share of itself.
    """
    explained = torque.train_after < NUMBERS.explained_chi2_dof * torque.floor**2
    lost = [e for e in torque.effects if catalogue.declaration(e.candidate.name).motor_side]
    passed = [e for e in torque.effects if not catalogue.declaration(e.candidate.name).motor_side]
    out = []
    for k, run in enumerate(runs):
        load = available(run.rigid).copy()
        for j, joint in enumerate(torque.group.joints):
            if explained[j]:
                load[:, joint] += torque.links[j][k] + _sum(passed, j, k)
            else:
                load[:, joint] = _smooth(available(run.torque)[:, joint] - _sum(lost, j, k), run.step_s)
        out.append(replace(run, load=load, load_error=_error(torque, explained, k, load)))
    return tuple(out)


def _error(torque: MotionFit, explained: np.ndarray, run: int, load: np.ndarray) -> np.ndarray:
    """(T, n, r) of the load (T, n) of one run: the errors that explained joints have in common, then one of each other joint."""
    common = torque.load_error[run]
    alone = np.flatnonzero(~explained)
    out = np.zeros((*load.shape, common.shape[2] + len(alone)))
    for j, joint in enumerate(torque.group.joints):
        if explained[j]:
            out[:, joint, : common.shape[2]] = common[:, j]
    for r, j in enumerate(alone, common.shape[2]):
        joint = torque.group.joints[j]
        out[:, joint, r] = NUMBERS.unexplained_load_uncertainty * load[:, joint]
    return out


def _sum(effects: list[FittedEffect], j: int, run: int) -> np.ndarray | float:
    return sum((e.contributions[j][run] for e in effects), 0.0)


def _smooth(load: np.ndarray, step_s: float) -> np.ndarray:
    window = min(max(2 * int(NUMBERS.load_window_s / step_s / 2) + 1, 5), (len(load) - 1) // 2 * 2 - 1)
    return np.asarray(savgol_filter(load, window, 2))


def motion_series(
    fits: Sequence[MotionFit], channels: Sequence[ChannelFit], trajectories: Sequence[Trajectory], runs: Sequence[MotionSignals]
) -> MotionSeries:
    """Every channel over time, as it was fitted to all data. A joint whose model is refused (``channels``) has none: after is as before."""
    names = tuple(dict.fromkeys(t.name for t in trajectories))
    refused = {(c.channel, c.at) for c in channels if c.refused_rms is not None}
    found = []
    for fit in fits:
        unit, scale = fit.group.shown_unit, fit.group.scale
        shown = fit.group.signal if fit.group.name == "tau" else fit.group.mismatch
        for j, joint in enumerate(fit.group.joints):
            at = fit.group.axes[joint]
            kept = fit.residual_before if (fit.group.name, at) in refused else fit.residual_after
            for k, (trajectory, run) in enumerate(zip(trajectories, runs, strict=True)):
                measured = shown[k][:, j]
                before, after = (scale * np.where(fit.used[j][k], measured - left[j][k], np.nan) for left in (fit.residual_before, kept))
                time = float(trajectory.time_s[0]) + run.step_s * np.arange(len(measured))
                number = names.index(trajectory.name)
                found.append(ChannelSeries(fit.group.name, at, unit, number, time, measured=scale * measured, before=before, after=after))
    return MotionSeries(trajectories[0].robot.name, names, tuple(found))
