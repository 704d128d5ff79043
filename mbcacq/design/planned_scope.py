"""What the poses of a plan will be calibrated for, by the rule that their recording will be judged by."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq.calibration.sufficiency import HAND_EYE_ALONE, options_for, refuse_insufficient
from mbcacq.design.simulated_observations import planned_observations
from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose

PART_ALONE = "no pose expects a ball; the cell will be calibrated by how the scans of its part stand to each other"


def planned_scope(observations: Observations) -> CalibrationOptions:
    """The options that these planned observations will be calibrated with.

    Raises CalibrationError, with the sentence that a calibration would refuse the recording with, where it would.
    """
    options = options_for(observations, CalibrationOptions())
    refuse_insufficient(select_phases(observations, options), options)
    return options


def scope_sentence(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> str:
    """What a calibration of these poses will leave out or refuse; '' where it determines the whole cell."""
    useful = [p for p in poses if p.balls]
    if not useful:
        if scans_part(loaded, poses):
            return PART_ALONE
        return "no pose expects a ball; nothing will be calibrated"
    try:
        options = planned_scope(planned_observations(loaded, useful))
    except CalibrationError as error:
        return f"a calibration will refuse these poses: {error}"
    return "" if options.kinematics else HAND_EYE_ALONE


def scans_part(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> bool:
    """Whether any of these poses scans a part."""
    return any(loaded.cell.artefact(pose.artefact).is_part for pose in poses)
