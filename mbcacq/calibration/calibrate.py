"""``calibrate``: observations in, calibrated cell out. ``_calibrate`` is the method on one page, as docs/explanation/method.md has it.

What stands behind its first line, the sum that is smallest and the noise that is most probable, is ``mbcacq.estimation.adjustment``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.change import ChangeEvidence, evidence_of_change
from mbcacq.calibration.change_found import ChangeFound
from mbcacq.calibration.clock_term import with_clock, with_clock_term
from mbcacq.calibration.competing_methods import best_on_held_out
from mbcacq.calibration.contradiction import fault_while_recording, with_contradiction
from mbcacq.calibration.description import likely_cause_named
from mbcacq.calibration.published_cell import (
    averaged_over_changes,
    cell_of,
    with_accident,
    with_length_uncertainty,
    with_loads,
    with_nominal_arm,
    with_notes_on_poses,
)
from mbcacq.calibration.recording_faults import with_joint_noise_check
from mbcacq.calibration.staged import calibrate_paper
from mbcacq.calibration.sufficiency import refuse_insufficient, refuse_poor, refuse_runaway, refuse_unknown_arm
from mbcacq.calibration.with_discrepancy import evidence_gain, with_discrepancy
from mbcacq.calibration.with_effects import refitted, refitted_effects
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import CalibrationError, ContradictionError, MbcacqError
from mbcacq.estimation.adjustment import Adjustment, adjust_recording, with_random_links
from mbcacq.estimation.options import CalibrationOptions, select_phases, without_copies
from mbcacq.estimation.solver import one_thread
from mbcacq.estimation.terms import Term, own_errors
from mbcacq.model.observations import Observations


def calibrate(observations: Observations, options: CalibrationOptions | None = None) -> CalibratedCell:
    """Identify the cell from a recording.

    Raises CalibrationError naming what the poses leave undetermined, ConfigError for options that do not fit.
    """
    try:
        with one_thread(), likely_cause_named(observations):
            found = with_notes_on_poses(_calibrate(observations, options or CalibrationOptions()), observations)
            return replace(with_loads(found), own_adjustment=None, calibrate_again=calibrate_with_effects)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"the measured centres contradict each other so much that no cell fits them ({error}); look for values "
            "that are not millimetres, and for poses or balls taken for others"
        ) from error


def calibrate_with_effects(
    observations: Observations, options: CalibrationOptions | None, model: EffectModel, *, hold: bool = False
) -> CalibratedCell:
    """The cell with effects; see ``mbcacq.calibration.with_effects.refitted``."""
    found = refitted(observations, options, model, calibrate, hold=hold)
    return replace(with_loads(found), calibrate_again=calibrate_with_effects)


def effects_fitted_with_the_cell(observations: Observations, options: CalibrationOptions, model: EffectModel) -> EffectModel | None:
    """The effects alone of ``calibrate_with_effects``; see ``mbcacq.calibration.with_effects.refitted_effects``."""
    return refitted_effects(observations, options, model, calibrate)


def _calibrate(observations: Observations, options: CalibrationOptions) -> CalibratedCell:
    """The cell with its adjustment; that of the published method has none."""
    refuse_unknown_arm(observations, options)
    if options.method == "paper":
        return _staged(observations, options)
    obs = without_copies(select_phases(observations, options))
    refuse_insufficient(obs, options)
    options = with_clock_term(obs, replace(options, terms=(*options.terms, *own_errors(obs))))
    adjusted = _adjusted(obs, options)
    if options.kinematics:
        return with_clock(_arm_and_hand_eye(cell_of(with_random_links(adjusted))))
    return with_clock(with_length_uncertainty(_hand_eye(cell_of(adjusted))))


def _adjusted(obs: Observations, options: CalibrationOptions) -> Adjustment:
    """Raises CalibrationError as ``adjust_recording``, with what happened while the recording was made where that is why."""
    try:
        return adjust_recording(obs, options, links_follow=options.kinematics)
    except ContradictionError:
        raise
    except CalibrationError as error:
        fault = fault_while_recording(adjust_recording(obs, replace(options, refuse=False)))
        raise (CalibrationError(f"{fault} (as it is, {error})") if fault else error) from None


def _arm_and_hand_eye(cell: CalibratedCell) -> CalibratedCell:
    """With smooth errors of the joints where the evidence asks for them; a simpler one where it predicts better; and a warning where the
    joints' noise is beyond the data sheet."""
    refuse_unusable(cell)
    options, fault, change = cell.fit.options, "", ChangeEvidence()
    if options.discrepancy:
        fault, change = fault_while_recording(cell.adjustment), evidence_of_change(cell.adjustment)
    # An event that happened once must not become a function of posture; terms that are given are somebody's account of the arm's errors.
    if options.discrepancy and not options.terms and not fault:
        cell, change = _smooth_or_sudden(cell, change)
    cell = averaged_over_changes(cell, change)
    if options.discrepancy and not options.terms and not fault and change.found is None:
        cell = best_on_held_out(cell)
    cell = with_joint_noise_check(cell)
    explained_by_a_pose = cell.extra.get("joint_noise_check", {}).get("pose") is not None
    return with_accident(cell, change.found or ("" if explained_by_a_pose else fault))


def _smooth_or_sudden(cell: CalibratedCell, change: ChangeEvidence) -> tuple[CalibratedCell, ChangeEvidence]:
    """The cell with smooth errors of the joints where the evidence asks for them, and the change beside them, unless the change is the
    better explanation: what depends on posture is no accident."""
    smooth = with_discrepancy(cell.adjustment)
    if smooth is None or (change.found is not None and change.log_e > evidence_gain(smooth)):
        return cell, change
    return smooth, evidence_of_change(smooth.adjustment)


def _hand_eye(cell: CalibratedCell) -> CalibratedCell:
    """With the nominal arm as it is; refused, or with a warning, where the recording contradicts its description."""
    if not cell.fit.options.discrepancy:
        return cell
    cell = with_contradiction(cell)
    change = evidence_of_change(cell.adjustment)
    if change.found is not None:
        smooth, beside = _smooth_or_sudden(cell, change)
        if smooth is not cell:
            change = replace(change, found=beside.found, log_e=change.log_e - evidence_gain(smooth))
    cell = with_accident(with_nominal_arm(averaged_over_changes(cell, change)), change.found)
    refuse_unusable(cell)
    return cell


def changed_while_recorded(obs: Observations, displaced: tuple[tuple[Term, np.ndarray], ...] = ()) -> ChangeFound | None:
    """The change that a recording shows with its arm as described, whose links err at random; None if poses are too few to say.

    displaced: effects that are known, as ``CalibrationOptions`` has them.
    """
    try:
        with one_thread():
            cell = cell_of(adjust_recording(obs, CalibrationOptions(kinematics=False, refuse=False, displaced=displaced)))
            change = evidence_of_change(cell.adjustment)
            return None if change.found is None else _smooth_or_sudden(cell, change)[1].found
    except (MbcacqError, np.linalg.LinAlgError):
        return None


def _staged(observations: Observations, options: CalibrationOptions) -> CalibratedCell:
    cell = calibrate_paper(observations, options)
    refuse_unusable(cell)
    refuse_runaway(cell.state.chain, cell.nominal, options)
    return cell


def refuse_unusable(cell: CalibratedCell) -> None:
    """Raise CalibrationError where everything is determined, but so poorly that the result would be of no use."""
    refuse_poor(cell.layout, cell.covariance, cell.expected_accuracy(postures=100), cell.fit.observations, cell.fit.options)
