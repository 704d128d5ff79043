"""Calibration by maximum likelihood: the adjusted cell with its covariance, and what speaks against trusting it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from mbcacq.calibration.causes import misdescribed
from mbcacq.calibration.contradiction import contradiction, refuse_contradiction
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
from mbcacq.estimation.phases import select_phases
from mbcacq.model.observations import Observations


def calibrate(observations: Observations, options: CalibrationOptions | None = None) -> Calibration:
    """Identify the cell from a recording.

    Raises CalibrationError naming what the poses leave undetermined, ConfigError for options that do not fit.
    """
    options = options or CalibrationOptions()
    try:
        with threadpool_limits(1):  # the matrices are small: two threads of linear algebra take longer for them than one
            return _calibrate(observations, options)
    except ContradictionError as error:
        cause = misdescribed(observations)
        raise (CalibrationError(f"{error}; {cause}") if cause else error) from None
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"the measured centres contradict each other so much that no cell fits them ({error}); look for values "
            "that are not millimetres, and for poses or balls taken for others"
        ) from error


def _calibrate(observations: Observations, options: CalibrationOptions) -> Calibration:
    refuse_unknown_arm(observations, options)
    if options.method == "paper":
        from mbcacq.calibration.staged import calibrate_paper

        result = calibrate_paper(observations, options)
        refuse_poor(result.layout, result.covariance, expected_accuracy(result, postures=100), result.observations, options)
        refuse_runaway(result.state.chain, result.observations.cell.robot.chain, options)
        return result
    obs = select_phases(observations, options)
    refuse_insufficient(obs, options)
    fitted = adjust_recording(obs, options)
    if options.kinematics:
        return _arm_and_hand_eye(obs, options, fitted)
    result = Calibration.adjusted(obs, options, fitted)
    return _hand_eye_alone(result, fitted) if options.discrepancy else result


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
    result = Calibration.adjusted(obs, options, fitted)
    refuse_unusable(result)
    # Terms that are given are somebody's account of what the arm does beyond its geometry.
    found = with_discrepancy(obs, options, fitted) if options.discrepancy and not options.terms else None
    if found is not None:
        fitted = found.adjustment
        result = Calibration.adjusted(obs, found.options, fitted)
        extra = {**result.extra, "discrepancy": {"log_evidence_gain": found.gain}}
        result = replace(result, options=options, effects=with_estimates(found.model, result), extra=extra)
    return _with_joint_noise_check(result, fitted)


def refuse_unusable(result: Calibration) -> None:
    """Raise CalibrationError where everything is determined, but so poorly that the result would be of no use."""
    refuse_poor(result.layout, result.covariance, expected_accuracy(result, postures=100), result.observations, result.options)


def _with_joint_noise_check(result: Calibration, fitted: Adjustment) -> Calibration:
    found = joint_noise_check(fitted.lineariser, fitted.solution, fitted.noise, result.covariance)
    if found is None:
        return result
    return replace(result, extra={**result.extra, "joint_noise_check": found, "warnings": [joint_noise_sentence(found)]})
