"""Calibration by maximum likelihood: the adjusted cell with its covariance, and what speaks against trusting it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from mbcacq.calibration.causes import misdescribed
from mbcacq.calibration.contradiction import contradiction, fault_while_recording, refuse_contradiction, stated_chi2_dof
from mbcacq.calibration.estimates import with_estimates
from mbcacq.calibration.influence import joint_noise_check, joint_noise_sentence
from mbcacq.calibration.nominal_arm import with_nominal_arm
from mbcacq.calibration.result import Calibration
from mbcacq.calibration.sufficiency import refuse_insufficient, refuse_poor, refuse_runaway, refuse_unknown_arm
from mbcacq.calibration.uncertainty import expected_accuracy
from mbcacq.calibration.with_discrepancy import with_discrepancy
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.estimation.adjustment import Adjustment, adjust_recording
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.phases import copies, select_phases, without_copies
from mbcacq.model.joint_resolution import rounding_sentence
from mbcacq.model.observations import Observations


def calibrate(observations: Observations, options: CalibrationOptions | None = None) -> Calibration:
    """Identify the cell from a recording.

    Raises CalibrationError naming what the poses leave undetermined, ConfigError for options that do not fit.
    """
    options = options or CalibrationOptions()
    try:
        with threadpool_limits(1):  # the matrices are small: two threads of linear algebra take longer for them than one
            return _with_rounding_said(_with_copies_said(_calibrate(observations, options), observations))
    except ContradictionError as error:
        cause = misdescribed(observations)
        raise (CalibrationError(f"{error}; {cause}") if cause else error) from None
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"the measured centres contradict each other so much that no cell fits them ({error}); look for values "
            "that are not millimetres, and for poses or balls taken for others"
        ) from error


def _with_copies_said(result: Calibration, observations: Observations) -> Calibration:
    twice = observations.pose_id[copies(observations)]
    if not len(twice):
        return result
    some = ", ".join(map(str, twice[:5])) + (", .." if len(twice) > 5 else "")
    said = f"{len(twice)} poses are exact copies of earlier ones ({some}) and are counted once; measure again instead of copying"
    return replace(result, extra={**result.extra, "warnings": [*result.extra.get("warnings", ()), said]})


def _with_rounding_said(result: Calibration) -> Calibration:
    if not (step := result.cell.joint_step):
        return result
    return replace(result, extra={**result.extra, "warnings": [*result.extra.get("warnings", ()), rounding_sentence(step)]})


def _calibrate(observations: Observations, options: CalibrationOptions) -> Calibration:
    refuse_unknown_arm(observations, options)
    if options.method == "paper":
        from mbcacq.calibration.staged import calibrate_paper

        result = calibrate_paper(observations, options)
        refuse_poor(result.layout, result.covariance, expected_accuracy(result, postures=100), result.observations, options)
        refuse_runaway(result.state.chain, result.observations.cell.robot.chain, options)
        return result
    obs = without_copies(select_phases(observations, options))
    refuse_insufficient(obs, options)
    fitted = _adjusted(obs, options)
    if options.kinematics:
        return _arm_and_hand_eye(obs, options, fitted)
    result = _collected(obs, options, fitted)
    return _hand_eye_alone(result, fitted) if options.discrepancy else result


def _collected(obs: Observations, options: CalibrationOptions, fitted: Adjustment) -> Calibration:
    """The result of an adjustment, with its chi square under the stated noise."""
    result = Calibration.adjusted(obs, options, fitted)
    stated = stated_chi2_dof(fitted, result.dof)
    return result if stated is None else replace(result, extra={**result.extra, "stated_chi2_dof": stated})


def _adjusted(obs: Observations, options: CalibrationOptions) -> Adjustment:
    """Raises CalibrationError as ``adjust_recording``, with what happened while the recording was made where that is why."""
    try:
        return adjust_recording(obs, options)
    except ContradictionError:
        raise
    except CalibrationError as error:
        fault = fault_while_recording(adjust_recording(obs, replace(options, refuse=False)))
        raise (CalibrationError(f"{fault} (as it is, {error})") if fault else error) from None


def _hand_eye_alone(result: Calibration, fitted: Adjustment) -> Calibration:
    """With the nominal arm as it is; refused, or with a warning, where the recording contradicts its description."""
    found = contradiction(fitted, result.options)
    if found is not None:
        refuse_contradiction(found, result.observations, result.options)
        said = {"contradiction": found.to_dict(), "warnings": [found.sentence(result.cell)]}
        result = replace(result, extra={**result.extra, **said})
    result = with_nominal_arm(result, fitted.lineariser)
    refuse_unusable(result)
    return result


def _arm_and_hand_eye(obs: Observations, options: CalibrationOptions, fitted: Adjustment) -> Calibration:
    """With smooth errors of the joints where the evidence asks for them, and a warning where their noise is beyond the data sheet."""
    result = _collected(obs, options, fitted)
    refuse_unusable(result)
    fault = fault_while_recording(fitted) if options.discrepancy else ""
    # What happened once must not become a function of posture; terms that are given are somebody's account of the arm's errors.
    found = with_discrepancy(obs, options, fitted) if options.discrepancy and not options.terms and not fault else None
    if found is not None:
        fitted = found.adjustment
        result = _collected(obs, found.options, fitted)
        extra = {**result.extra, "discrepancy": {"log_evidence_gain": found.gain}}
        result = replace(result, options=options, effects=with_estimates(found.model, result), extra=extra)
    result = _with_joint_noise_check(result, fitted)
    check = result.extra.get("joint_noise_check")
    if not fault or (check and check["pose"] is not None):
        return result
    warnings = [f"Something changed while the recording was made: {fault}", *result.extra.get("warnings", ())]
    return replace(result, extra={**result.extra, "warnings": warnings})


def refuse_unusable(result: Calibration) -> None:
    """Raise CalibrationError where everything is determined, but so poorly that the result would be of no use."""
    refuse_poor(result.layout, result.covariance, expected_accuracy(result, postures=100), result.observations, result.options)


def _with_joint_noise_check(result: Calibration, fitted: Adjustment) -> Calibration:
    found = joint_noise_check(fitted.lineariser, fitted.solution, fitted.noise, result.covariance)
    if found is None:
        return result
    return replace(result, extra={**result.extra, "joint_noise_check": found, "warnings": [joint_noise_sentence(found)]})
