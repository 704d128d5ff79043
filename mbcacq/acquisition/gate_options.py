"""The limits by which exposures and joint angles are judged during a run, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """Limits of one run. Lengths in mm, angles in rad. ``sigmas`` are multiples of a standard uncertainty."""

    # Agreement of the exposures of one pose. The sigma is the largest of the sphere fit's, the stated noise and the scatter seen so far.
    agreement_sigmas: float = 6.0  # of the difference of two centres: far in the tail of a normal distribution
    least_disagreement_mm: float = 0.1  # one of three exposures off by less moves their mean by less than an arm's repeatability
    unstated_noise_factor: float = 4.0  # of the distance of the two closest exposures, where the plan states no noise of the scanner

    # Prediction from the station's earlier poses and the nominal arm (standard uncertainties).
    prediction_sigmas: float = 6.0  # an innocent pose left out costs a pose; a wrong one costs the calibration
    arm_mm: float = 1.0  # position error of a nominal arm that was mastered; the data sheets' few tenths are those of single links
    arm_rad: float = 1e-3  # its orientation error: 0.06 deg, several joints each off by as much as a calibration finds
    centre_mm: float = 0.1  # of one ball against the others: certificate, scanner scale and noise
    mount_mm: float = 10.0  # a hand-eye taken from a drawing, with the scanner's frame behind its housing
    mount_rad: float = 0.05
    station_share: float = 0.5  # of station_tolerance_mm, the largest error of a placement
    station_rad: float = 0.1  # an artefact put down by hand

    # What follows from a failed check.
    repeated_exposures: int = 3  # for one pose; a single damaged scan needs one, an artefact that still swings some seconds
    poses_in_a_row: int = 3  # so many left out one after the other are no accident: the artefact or the arm is not where it was

    # Joint angles during the exposures.
    standstill_tolerances: float = 2.0  # of tolerance_deg: to either side of the target
