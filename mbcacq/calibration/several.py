"""Calibration of one arm from several recordings: the arm and its effects are shared, every recording keeps its own cell around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from mbcacq.calibration.calibrate import calibrate_with_effects, refuse_unusable
from mbcacq.calibration.calibrated_cell import CalibratedCell, adjusted_cell
from mbcacq.calibration.published_cell import with_estimates, with_nominal_arm
from mbcacq.calibration.share import share_of
from mbcacq.calibration.with_effects import fitted_with_effects, refuse_effects_of_other_arm
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect import ON_THE_ARM
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.learnt_range import learnt_ranges
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.adjustment import Adjustment, adjust, with_random_links
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.several_recordings import BetweenRecordings, joint_problem
from mbcacq.estimation.solution import system
from mbcacq.estimation.terms import PER_POSE, Term
from mbcacq.model.json_text import Number, fields_as_json
from mbcacq.model.observations import Observations


@dataclass(frozen=True, kw_only=True)
class DayToDay(BetweenRecordings):
    """A coefficient of an effect on the arm in several recordings, as a joint result has it."""

    parameter: Annotated[str, Field(alias="coefficient")]
    unit: str
    stds: Annotated[tuple[Number, ...], Field(alias="std")]


def calibrate_together(
    recordings: Sequence[Observations], options: CalibrationOptions | None = None, effects: EffectModel | None = None, *, hold: bool = False
) -> tuple[CalibratedCell, ...]:
    """One calibration for each recording: all have the same arm and effects, with the covariance that all recordings together give them.

    Base, tool, stations, artefacts and noise are each recording's own. effects: terms of the arm, refitted to all recordings or, with
    ``hold``, kept. A coefficient that differs between the recordings by more than they explain is a random effect. The common value is
    reported. Its variance is the sum of that of the common value and that between recordings, as it holds on another day. 'day_to_day' of
    ``extra`` has the values of each coefficient in every recording.

    Raises ConfigError if the recordings are not of one arm, CalibrationError if one contradicts its cell.
    """
    options = options or CalibrationOptions()
    if options.method != "ml":
        raise ConfigError("several recordings are calibrated together by --method ml; give one recording to the staged method")
    for number, one in enumerate(recordings if effects else (), 1):
        assert effects is not None, "there are some"
        refuse_effects_of_other_arm(one, effects, f"recording {number}")
    try:
        return _together(*joint_problem(recordings, options), options, effects, hold)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recordings contradict each other so much that no arm fits them ({error})") from error


def _together(
    together: Observations,
    start: CellState,
    parts: Sequence[Adjustment],
    options: CalibrationOptions,
    effects: EffectModel | None,
    hold: bool,
) -> tuple[CalibratedCell, ...]:
    """start: the state from which all are adjusted; parts: each recording by itself, as it was fitted alone."""
    found: list[DayToDay] = []

    def fit(obs: Observations, asked: CalibrationOptions) -> CalibratedCell:
        """All recordings with the terms of some options, whose coefficients may differ from day to day."""
        whole = _fitted(together, replace(asked, start=start))
        if effects is None or not asked.terms or len(parts) < 2:
            return whole
        found[:] = day_to_day(whole, effects.parametric)
        between = {d.parameter: d.between_std for d in found if d.between_std > 0}
        own = deviations(whole, between)
        return _fitted(together, replace(asked, start=start, terms=(*asked.terms, *own))) if own else whole

    if effects is None:
        whole = fit(together, options)
    else:
        if not hold:
            here = Covariates(together)
            effects = replace(effects, terms=tuple(replace(t, ranges=learnt_ranges(here, t.parts)) for t in effects.terms))
        whole = fitted_with_effects(together, options, effects, hold, fit)
    if found:
        assert effects is not None, "they differ from day to day"
        between = {d.parameter: d.between_std for d in found if d.between_std > 0}
        whole = replace(whole, covariance=whole.covariance + np.diag([between.get(name, 0.0) ** 2 for name in whole.names]))
        if not hold and whole.effects is not None:
            whole = replace(whole, effects=with_estimates(whole.effects, whole))
        whole = replace(whole, extra={**whole.extra, "day_to_day": [fields_as_json(d) for d in found]})
    each = shares(whole, parts, options)
    refuse_unusable(each[0])
    return each


def _fitted(obs: Observations, options: CalibrationOptions) -> CalibratedCell:
    fitted = adjust(obs, options, links_follow=options.kinematics)
    fitted = with_random_links(fitted) if options.kinematics else fitted
    result = adjusted_cell(options, fitted)
    return result if options.kinematics or not options.discrepancy else with_nominal_arm(replace(result, own_adjustment=fitted))


def day_to_day(whole: CalibratedCell, model: EffectModel) -> list[DayToDay]:
    """Each coefficient of the effects on the arm in every recording by itself, with the geometry of all, at a calibration of all."""
    obs = whole.fit.observations
    assert obs.recording is not None, "asked of several recordings only"
    known = {name: t for t in model.terms if t.where[0].startswith(ON_THE_ARM) and not t.bound_to_recording for name in t.names}
    if not known:
        return []
    built, start = [], []
    for t, values in zip(whole.fit.options.terms, whole.fit.coefficients, strict=True):
        wanted = [j for j, name in enumerate(t.names) if name in known]
        built += [_of_each_recording(obs, t, j, np.inf) for j in wanted] if wanted else [t]
        start += [np.full(obs.n_recordings, values[j]) for j in wanted] if wanted else [values]
    options = replace(whole.fit.options, terms=tuple(built))
    layout = build(obs, options).holding(whole.layout.held)
    at = system(Lineariser(obs, layout, options), Estimate(whole.state, tuple(start)), whole.noise, whole.fit.weights)
    scale = layout.scale
    H = scale[:, None] * at.normal.information * scale
    covariance = scale[:, None] * np.linalg.inv(H + 1e-14 * np.diag(H).max() * np.eye(len(H))) * scale
    step = covariance @ at.normal.gradient
    position = {name: j for j, name in enumerate(layout.names)}
    out = []
    for t, values in zip(built, start, strict=True):
        name = t.name
        if name in known:
            index, of = [position[one] for one in t.names], known[name]
            values, std = values + step[index], np.sqrt(np.diag(covariance)[index])
            out.append(DayToDay.of(of.name, of.where, name, values, std, unit=of.units[of.names.index(name)]))
    return out


def deviations(whole: CalibratedCell, between: dict[str, float]) -> list[Term]:
    """The difference of each recording from the common value of coefficients that differ by a standard deviation ``between``, by name."""
    return [
        replace(_of_each_recording(whole.fit.observations, t, j, between[name]), name=f"{name} of each recording")
        for t in whole.fit.options.terms
        for j, name in enumerate(t.names)
        if name in between
    ]


def _of_each_recording(obs: Observations, t: Term, j: int, sigma: float) -> Term:
    """Coefficient ``j`` of a term once for every recording."""
    count = obs.n_recordings
    assert obs.recording is not None, "asked of several recordings only"
    here = (obs.recording[:, None] == np.arange(count)).astype(float)
    parts = tuple(replace(p, basis=p.basis[:, j : j + 1] * (here if p.place in PER_POSE else here[obs.pose])) for p in t.parts)
    names = tuple(f"{t.names[j]}@{r + 1}" for r in range(count))
    return Term(t.names[j], parts, names, (t.units[j],) * count, np.full(count, sigma))


def shares(whole: CalibratedCell, parts: Sequence[Adjustment], options: CalibrationOptions) -> tuple[CalibratedCell, ...]:
    """The share of each recording in a calibration of all. parts: each recording by itself, as it was fitted alone."""
    cells = (
        CalibratedCell.fitted(*share_of(whole.fit, whole, parts, r, options), part.preliminary, whole.extra) for r, part in enumerate(parts)
    )
    return tuple(replace(cell, calibrate_again=calibrate_with_effects) for cell in cells)
