"""Calibration by maximum likelihood: the adjusted cell with its covariance, and what speaks against trusting it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell, adjusted_cell
from mbcacq.calibration.change import ChangeEvidence, evidence_of_change, found_change
from mbcacq.calibration.competing_methods import compared_on_held_out, plain_least_squares
from mbcacq.calibration.contradiction import contradiction, fault_while_recording, refuse_contradiction, stated_chi2_dof
from mbcacq.calibration.description import misdescribed
from mbcacq.calibration.published_cell import with_estimates, with_length_uncertainty, with_nominal_arm
from mbcacq.calibration.recording_faults import InfluenceOptions, joint_factor, joint_noise_check, joint_noise_sentence
from mbcacq.calibration.sufficiency import refuse_insufficient, refuse_poor, refuse_runaway, refuse_unknown_arm
from mbcacq.calibration.with_discrepancy import with_discrepancy
from mbcacq.calibration.with_effects import refitted, refitted_effects
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.estimation.adjustment import Adjustment, adjust_recording, with_random_links
from mbcacq.estimation.options import CalibrationOptions, copies, select_phases, without_copies
from mbcacq.estimation.solver import one_thread
from mbcacq.model.joint_resolution import rounding_sentence
from mbcacq.model.observations import Observations


def calibrate(observations: Observations, options: CalibrationOptions | None = None) -> CalibratedCell:
    """Identify the cell from a recording.

    Raises CalibrationError naming what the poses leave undetermined, ConfigError for options that do not fit.
    """
    options = options or CalibrationOptions()
    try:
        with one_thread():
            said = _with_rounding_said(_with_copies_said(_calibrate(observations, options), observations))
            return replace(said, calibrate_again=calibrate_with_effects)
    except ContradictionError as error:
        cause = misdescribed(observations)
        raise (CalibrationError(f"{error}; {cause}") if cause else error) from None
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"the measured centres contradict each other so much that no cell fits them ({error}); look for values "
            "that are not millimetres, and for poses or balls taken for others"
        ) from error


def calibrate_with_effects(
    observations: Observations, options: CalibrationOptions | None, model: EffectModel, *, hold: bool = False
) -> CalibratedCell:
    """The cell with effects; see ``mbcacq.calibration.with_effects.refitted``."""
    return replace(refitted(observations, options, model, calibrate, hold=hold), calibrate_again=calibrate_with_effects)


def effects_fitted_with_the_cell(observations: Observations, options: CalibrationOptions, model: EffectModel) -> EffectModel | None:
    """The effects alone of ``calibrate_with_effects``; see ``mbcacq.calibration.with_effects.refitted_effects``."""
    return refitted_effects(observations, options, model, calibrate)


def _with_copies_said(result: CalibratedCell, observations: Observations) -> CalibratedCell:
    twice = observations.pose_id[copies(observations)]
    if not len(twice):
        return result
    some = ", ".join(map(str, twice[:5])) + (", .." if len(twice) > 5 else "")
    return _warned(
        result, f"{len(twice)} poses are exact copies of earlier ones ({some}) and are counted once; measure again instead of copying"
    )


def _with_rounding_said(result: CalibratedCell) -> CalibratedCell:
    step = result.fit.observations.cell.joint_step
    return _warned(result, rounding_sentence(step)) if step else result


def _calibrate(observations: Observations, options: CalibrationOptions) -> CalibratedCell:
    refuse_unknown_arm(observations, options)
    if options.method == "paper":
        from mbcacq.calibration.staged import calibrate_paper

        result = calibrate_paper(observations, options)
        refuse_unusable(result)
        refuse_runaway(result.state.chain, result.nominal, options)
        return result
    obs = without_copies(select_phases(observations, options))
    refuse_insufficient(obs, options)
    fitted = _adjusted(obs, options)
    if options.kinematics:
        fitted = with_random_links(fitted)
        return _arm_and_hand_eye(obs, options, fitted)
    result = _collected(options, fitted)
    result = _hand_eye_alone(result, fitted) if options.discrepancy else result
    lenient = replace(options, refuse=False)
    return with_length_uncertainty(result, lambda other: adjust_recording(other, lenient).state)


def _collected(options: CalibrationOptions, fitted: Adjustment) -> CalibratedCell:
    """The result of an adjustment, with its chi square under the stated noise."""
    result = adjusted_cell(options, fitted)
    stated = stated_chi2_dof(fitted, result.fit.dof)
    return result if stated is None else replace(result, extra={**result.extra, "stated_chi2_dof": stated})


def _adjusted(obs: Observations, options: CalibrationOptions) -> Adjustment:
    """Raises CalibrationError as ``adjust_recording``, with what happened while the recording was made where that is why."""
    try:
        return adjust_recording(obs, options, links_follow=options.kinematics)
    except ContradictionError:
        raise
    except CalibrationError as error:
        fault = fault_while_recording(adjust_recording(obs, replace(options, refuse=False)))
        raise (CalibrationError(f"{fault} (as it is, {error})") if fault else error) from None


def _hand_eye_alone(result: CalibratedCell, fitted: Adjustment) -> CalibratedCell:
    """With the nominal arm as it is; refused, or with a warning, where the recording contradicts its description."""
    fit = result.fit
    found = contradiction(fitted, fit.options)
    if found is not None:
        refuse_contradiction(found, fit.observations, fit.options)
        said = {"contradiction": found.to_dict(), "warnings": [found.sentence(fit.observations.cell)]}
        result = replace(result, extra={**result.extra, **said})
    change, gain = evidence_of_change(fitted), 0.0
    if change.found is not None:
        smooth = with_discrepancy(fit.observations, fit.options, fitted)
        # What depends on posture is no accident: smooth errors of the joints may explain as much.
        if smooth is not None and change.log_e <= smooth.gain:
            gain, change = smooth.gain, replace(change, found=found_change(smooth.adjustment))
    result = _with_change(with_nominal_arm(result, fitted.lineariser), change, gain)
    refuse_unusable(result)
    return result


def _with_change(result: CalibratedCell, change: ChangeEvidence, gain: float = 0.0) -> CalibratedCell:
    """With the covariance as an average over the changes that are not excluded, and the one that is found said."""
    covariance = change.averaged(result.covariance, gain)
    result = replace(result, covariance=covariance, extra={**result.extra, **change.content(gain)})
    if change.found is None:
        return result
    return _warned(result, f"Something changed while the recording was made: {change.found.sentence}", first=True)


def _arm_and_hand_eye(obs: Observations, options: CalibrationOptions, fitted: Adjustment) -> CalibratedCell:
    """With smooth errors of the joints where the evidence asks for them; a simpler one where it predicts better; and a warning where the
    joints' noise is beyond the data sheet."""
    result = _collected(options, fitted)
    refuse_unusable(result)
    fault = fault_while_recording(fitted) if options.discrepancy else ""
    change = evidence_of_change(fitted) if options.discrepancy else ChangeEvidence()
    looked_at = fitted
    # An event that happened once must not become a function of posture; terms that are given are somebody's account of the arm's errors.
    if options.discrepancy and not options.terms and not fault:
        smooth = _with_discrepancy(obs, options, fitted)
        if smooth and (change.found is None or change.log_e <= smooth[0].extra["discrepancy"]["log_evidence_gain"]):
            result, fitted = smooth
            looked_at, change = fitted, evidence_of_change(fitted)
        if change.found is None and joint_factor(fitted.noise, obs.cell) > InfluenceOptions.noise_factor:
            result, fitted = _unless_it_loses(obs, options, result, fitted)
    result = _with_joint_noise_check(result, fitted)
    check = result.extra.get("joint_noise_check")
    if fitted is looked_at:
        result = _with_change(result, change)
    if not fault or change.found is not None or (check and check["pose"] is not None):
        return result
    return _warned(result, f"Something changed while the recording was made: {fault}", first=True)


def _with_discrepancy(obs: Observations, options: CalibrationOptions, alone: Adjustment) -> tuple[CalibratedCell, Adjustment] | None:
    """The calibration with smooth errors of the joints; None where the evidence does not ask for them."""
    found = with_discrepancy(obs, options, alone)
    if found is None:
        return None
    result = _collected(found.options, found.adjustment)
    said = {"log_evidence_gain": found.gain}
    if found.wander_rad is not None:
        said["wander_rad"] = found.wander_rad.tolist()
    effects = with_estimates(found.model, result) if found.model else None
    found_cell = replace(result, effects=effects, extra={**result.extra, "discrepancy": said})
    return _under(found_cell, options), found.adjustment


def _unless_it_loses(
    obs: Observations, options: CalibrationOptions, result: CalibratedCell, fitted: Adjustment
) -> tuple[CalibratedCell, Adjustment]:
    """The calibration, or the competing method that predicts held-out poses better."""
    own, lenient = "the weighted adjustment", replace(options, refuse=False)

    shared: dict[int, tuple[Observations, Adjustment]] = {}  # by identity, with what it is of: what is held here keeps its identity

    def linked(some: Observations) -> Adjustment:
        if id(some) not in shared:  # three of the methods begin with it
            shared[id(some)] = some, with_random_links(adjust_recording(some, lenient, links_follow=True))
        return shared[id(some)][1]

    fits: dict[str, Callable[[Observations], tuple[CalibratedCell, Adjustment]]] = {
        own: lambda some: _with_discrepancy(some, lenient, linked(some)) or _by(lenient, linked(some)),
        "the adjustment without smooth errors": lambda some: _by(lenient, linked(some)),
        "plain least squares": lambda some: _by(lenient, plain_least_squares(linked(some))),
        "the nominal arm": lambda some: _of_nominal_arm(some, lenient),
    }
    found = compared_on_held_out(obs, own, {name: lambda some, fit=fit: fit(some)[0] for name, fit in fits.items()})
    if found is None:
        return result, fitted
    if found.chosen != own:
        result, fitted = fits[found.chosen](obs)
        result = _warned(_under(result, replace(result.fit.options, refuse=options.refuse)), found.sentence(own))
    return replace(result, extra={**result.extra, "competing_methods": found.to_dict()}), fitted


def _by(options: CalibrationOptions, fitted: Adjustment) -> tuple[CalibratedCell, Adjustment]:
    return _collected(options, fitted), fitted


def _under(result: CalibratedCell, options: CalibrationOptions) -> CalibratedCell:
    """The result as one of these options."""
    return replace(result, own_fit=replace(result.fit, options=options))


def _of_nominal_arm(obs: Observations, options: CalibrationOptions) -> tuple[CalibratedCell, Adjustment]:
    options = replace(options, kinematics=False)
    fitted = adjust_recording(obs, options)
    return with_nominal_arm(_collected(options, fitted), fitted.lineariser), fitted


def _warned(result: CalibratedCell, sentence: str, first: bool = False) -> CalibratedCell:
    before = result.extra.get("warnings", ())
    return replace(result, extra={**result.extra, "warnings": [sentence, *before] if first else [*before, sentence]})


def refuse_unusable(result: CalibratedCell) -> None:
    """Raise CalibrationError where everything is determined, but so poorly that the result would be of no use."""
    refuse_poor(result.layout, result.covariance, result.expected_accuracy(postures=100), result.fit.observations, result.fit.options)


def _with_joint_noise_check(result: CalibratedCell, fitted: Adjustment) -> CalibratedCell:
    found = joint_noise_check(fitted.solution, fitted.noise, result.covariance)
    if found is None:
        return result
    return _warned(replace(result, extra={**result.extra, "joint_noise_check": found}), joint_noise_sentence(found))
