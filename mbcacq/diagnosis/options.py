"""The numbers that tune the diagnosis, each with its reason and, where there was one, the study that set it.

The numbers of the selection criteria, of the beam search and of the comparison of models stand in their own files.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DiagnosisOptions:
    """Tuning of a diagnosis. ``benchmarks/challenge.md`` measures all of it together; no field was fitted to a single recording."""

    # Size of the recording
    fewest_poses: int = 12  # fewer determine geometry and stations but no effect
    many_poses: int = 350  # a longer recording is searched with a narrower beam, and is modelled at all locations (time: diagnosis.md)
    most_poses: int = 20000  # a longer recording is thinned, so that memory stays below 3 GiB (benchmarks/diagnosis.md)
    searched_poses: int = 600  # poses of a long recording in which parametric effects are searched: bounds time and memory (diagnosis.md)

    # Outliers
    gross_medians: float = 8.0  # distance, in medians, up to which a centre takes part in a search although geometry alone rejects it
    gross_quantiles: float = 1.5  # or in distances that 97 % are within: more than 3 % are structure
    most_outliers: float = 0.05  # share of outliers beyond which they are structure, and stay

    # Candidates
    typical_multiple: float = 30.0  # prior sigma of a coefficient in typical sizes: an effect thirty times as large is not believed

    # Basis functions of unmodelled effects
    harmonics: int = 4  # periods a turn, of any joint's angle at any location
    own_harmonics: int = 9  # periods a turn, of the joint at, or before, the location
    cosines: int = 5  # smooth functions over the range of a covariate
    narrow_cosines: int = 16  # of a joint's own angle: narrow enough for a local bump
    fading_reaches: tuple[float, ...] = (0.1, 0.3, 1.0)  # rad of travel over which lost motion fades: grease, wind-up, pre-sliding
    standing_rad: float = 1e-4  # less travel is no motion; what was before it lasts
    parallel_cosine: float = 0.99  # from which two axes count as one, so that a link's rotation is left to the next joint
    shortest_period_mm: float = 8.0  # of periodic errors in the field of view
    most_harmonics: int = 16  # of periodic errors over the width of the field
    harmonic_weight: float = 0.3  # prior sigma of a harmonic relative to a polynomial of the same group

    # Random effects
    initial_size_mm: float = 0.02  # size of a group of coefficients at the start of the fixed-point iteration
    smallest_size: float = 0.03  # of the instrument noise: a group that moves less is dropped
    largest_size_mm: float = 10.0  # of a group: more is a wrong recording
    size_rounds: int = 25  # of that iteration at most

    # Search and validation
    few_stations: int = 6  # up to which each is left out alone
    usual_folds: int = 4  # of a recording of more stations
    long_folds: int = 3  # of a recording of many poses: each fold costs a whole fit
    longest_folds: int = 2  # and of one of at least ``longest_from`` poses (two minutes are allowed, diagnosis.md)
    longest_from: int = 2000
    deciding_share: float = 0.8  # share of the centres that must be at other stations for these alone to decide about a model
    noise_like_chi2: float = 1.5  # held-out chi2 per degree of freedom up to which a model may be said to leave only noise
    most_workers: int = 8  # processes at most: each holds a problem of its own in memory


OPTIONS = DiagnosisOptions()
