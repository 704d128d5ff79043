"""Calibration by maximum likelihood: the adjusted cell with its covariance, and what speaks against trusting it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.influence import joint_noise_check, joint_noise_sentence
from mbcacq.calibration.result import Calibration
from mbcacq.calibration.sufficiency import refuse_insufficient, refuse_poor, refuse_runaway, refuse_unknown_arm
from mbcacq.calibration.uncertainty import expected_accuracy
from mbcacq.calibration.with_discrepancy import with_discrepancy
from mbcacq.calibration.estimates import with_estimates
from mbcacq.description import with_likely_cause
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
        return _calibrate(observations, options)
    except ContradictionError as error:
        raise with_likely_cause(error, observations) from error
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
    found = with_discrepancy(obs, options, fitted) if options.kinematics and options.discrepancy else None
    if found is None:
        result = Calibration.adjusted(obs, options, fitted)
    else:
        alone, fitted = fitted, found.adjustment
        result = Calibration.adjusted(obs, found.options, fitted)
        result = replace(result, options=options, effects=with_estimates(found.model, result), extra={"discrepancy": {"log_evidence_gain": found.gain}})
    refuse_unusable(result)
    return _with_joint_noise_check(result, fitted) if options.kinematics else result  # a nominal arm's errors are noise there


def refuse_unusable(result: Calibration) -> None:
    """Raise CalibrationError where everything is determined, but so poorly that the result would be of no use."""
    refuse_poor(result.layout, result.covariance, expected_accuracy(result, postures=100), result.observations, result.options)


def _with_joint_noise_check(result: Calibration, fitted: Adjustment) -> Calibration:
    found = joint_noise_check(fitted.lineariser, fitted.solution, fitted.noise, result.covariance)
    if found is None:
        return result
    return replace(result, extra={**result.extra, "joint_noise_check": found, "warnings": [joint_noise_sentence(found)]})
