"""What a plan will determine, and how well: rank, observability and predicted accuracy, before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from mbcacq.calibration.calibrated_cell import CalibratedCell, adjusted_cell
from mbcacq.calibration.verification import ball_positions, pairs_of_balls, verification_poses
from mbcacq.design.planned_scope import planned_scope
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.estimation import identifiability
from mbcacq.estimation import parameters as blocks
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.identifiability import Undetermined
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise, select_phases
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.solution import system
from mbcacq.model.json_text import AsJson, keyed
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose

MEAN_OF_NORMAL = float(np.sqrt(2 / np.pi))  # mean of |error| over its standard deviation


@dataclass(frozen=True, kw_only=True)
class PredictedAccuracy(AsJson):
    """Accuracy that a linearisation at the planned cell predicts.

    Attributes
    ----------
    parameters, determined : int
        Numbers of arm and hand-eye parameters.
    indices
        O1..O5.
    workspace_mm
        The rms uncertainty of a measured point over the whole reach of the arm.
    distance_mm
        Expected mean error of a certified distance at the verification poses (None: there are none).
    calibration_mm
        The share of it that is the calibration's, without the noise of measuring the distance.
    distances
        (station, standard uncertainty in mm) of each. Where something that matters stays undetermined these are None or empty: then nothing
        can be promised, nor where the arm is taken as nominal (hand_eye_alone).
    correlated
        Pairs of parameters that cannot be told apart.
    weakest
        (name, its standard deviation, unit).
    """

    parameters: int
    determined: int
    hand_eye_alone: bool = False
    undetermined: tuple[Undetermined, ...]
    indices: Annotated[dict[str, float], Field(alias="observability")]
    workspace_mm: Annotated[float | None, Field(alias="expected_workspace_mm")]
    distance_mm: Annotated[float | None, Field(alias="expected_bar_mean_mm")]
    calibration_mm: Annotated[float | None, Field(alias="expected_bar_mean_of_calibration_mm")]
    distances: Annotated[tuple[Annotated[tuple[str, float], keyed("station", "expected_mm")], ...], Field(alias="places")]
    correlated: tuple[Annotated[tuple[str, str, float], keyed("a", "b", "correlation")], ...]
    weakest: tuple[Annotated[tuple[str, float, str], keyed("name", "std", "unit")], ...]


def predicted_accuracy(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> PredictedAccuracy:
    """Predicted accuracy of a calibration with these poses.

    Raises CalibrationError, with the sentence that a calibration would refuse the recording with, where the poses can determine nothing.
    """
    observations = planned_observations(loaded, poses)
    scope = planned_scope(observations)
    calibration = predicted_calibration(loaded, observations, planned_noise(loaded, poses), replace(scope, refuse=False))
    sound = scope.kinematics and all(u.harmless for u in calibration.fit.undetermined)
    pairs = calibration.verify(observations).places if sound else ()
    distances = tuple((p.station, p.expected_mm) for p in pairs if p.expected_mm is not None)
    used = _arm_parameters(calibration)
    undetermined = calibration.fit.undetermined
    of_arm_and_mount = [u for u in undetermined if not u.name.startswith("ball_")]
    lost = [u for u in of_arm_and_mount if scope.kinematics or u.name.startswith("hand_eye")]
    return PredictedAccuracy(
        parameters=len(used) + len(lost),
        determined=len(used),
        undetermined=undetermined,
        indices=calibration.observability,
        workspace_mm=calibration.expected_accuracy() if sound else None,
        distance_mm=MEAN_OF_NORMAL * float(np.mean([e for _, e in distances])) if distances else None,
        calibration_mm=MEAN_OF_NORMAL * float(np.mean(_calibration_share(calibration, observations))) if distances else None,
        distances=distances,
        correlated=tuple(c for c in calibration.fit.correlated if c[0] in used and c[1] in used),
        weakest=_weakest(calibration),
        hand_eye_alone=not scope.kinematics,
    )


def predicted_calibration(
    loaded: LoadedPlan, observations: Observations, noise: Noise, options: CalibrationOptions | None = None
) -> CalibratedCell:
    """The calibration that a recording of the planned cell would give: no residual, but the true covariance."""
    options = options or CalibrationOptions(refuse=False)
    obs = select_phases(observations, options)
    state = planned_state(loaded)
    layout, estimate = blocks.build(obs, options).resized(blocks.ORDINARY_LINKS), Estimate(state)
    lineariser = Lineariser(obs, layout, replace(options, refuse=False))
    weights = lineariser.everything
    first = system(lineariser, estimate, noise, weights)
    layout, found = identifiability.hold_undetermined(first)
    if options.kinematics and options.random_links:
        layout = blocks.with_common_sizes(layout, blocks.usual_sizes(obs.cell))
    solution = system(lineariser.with_layout(layout), estimate, noise, weights)
    return adjusted_cell(
        options, Adjustment(solution=solution, noise=noise, weights=weights, preliminary=state, found=found), known_noise=True
    )


def _calibration_share(calibration: CalibratedCell, observations: Observations) -> list[float]:
    """Standard uncertainty (mm) of each certified distance that the calibration alone leaves."""
    _, ends = ball_positions(verification_poses(observations), calibration.state)
    pairs = [(ends[station, a], ends[station, b]) for station, a, b in pairs_of_balls(ends)]
    return [float(calibration.distance_uncertainty(a[0], a[1], b[0], b[1])[0]) for a, b in pairs]


def _arm_parameters(calibration: CalibratedCell) -> list[str]:
    """Names of the parameters that are identified: without balls, and without links of an arm that stays nominal."""
    marginal = {p.name for p in calibration.parameters if p.status == "marginal"}
    return [name for name in calibration.names if not name.startswith("ball_") and name not in marginal]


def _weakest(calibration: CalibratedCell, count: int = 3) -> tuple[tuple[str, float, str], ...]:
    """The least well determined parameters: those of the largest standard deviation in units of a plausible size."""
    std = np.sqrt(np.diag(calibration.covariance))
    share = std / calibration.layout.scale
    unit = [u for b in calibration.layout.blocks for u, free in zip(b.units, b.free, strict=True) if free]
    identified = set(_arm_parameters(calibration))
    order = [i for i in np.argsort(-share) if calibration.names[i] in identified]
    return tuple((calibration.names[i], float(std[i]), unit[i]) for i in order[:count])
