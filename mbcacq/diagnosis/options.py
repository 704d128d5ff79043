"""The numbers that tune the diagnosis of poses, each with its reason and, where there was one, the study that set it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class DiagnosisOptions:
    """Tuning of a diagnosis. ``benchmarks/challenge.md`` measures all of it together; no field was fitted to a single recording."""

    # Size of the recording
    fewest_poses: int = 12  # fewer determine geometry and stations but no effect
    searched_poses: int = 600  # poses of a long recording in which effects are searched: bounds time and memory (diagnosis-rules.md)
    most_poses: int = 20000  # a longer recording is thinned, so that memory stays below 3 GiB (benchmarks/diagnosis.md)
    folds: int = 4  # of whole stations, or of blocks of one; two where half of the poses are still as many as are searched

    minutes: float = 30.0  # after which a search ends: the longest open recording takes one on two cores, and nobody waits for longer

    # Prior of effects
    sizes: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # of a coefficient's prior sigma, in typical sizes, equally probable
    further: float = 0.1  # prior probability of one more effect
    unmodelled: float = 0.01  # prior probability of an effect outside the catalogue, relative to one of the catalogue
    preferred: float = 0.8  # share of the preferred values of a hyper-parameter (the orders of a gear)

    # Exclusion limits
    largest_usual: float = 10.0  # typical sizes, beyond which no machine is believed to be: a limit there says nothing

    # Verdict. The evidence of all effects together has mean one without any effect, at every size of a recording that grows. With the noise
    # known it exceeds 100 at any look in less than 1 % of recordings (Ville's inequality). That the noise is estimated and sets are
    # searched is not covered by that (benchmarks/investigate.py looks). Below the lower value there is nothing to speak of: noise alone is
    # above it in 4 of 1000 recordings of 50 poses and more.
    least_e_value: float = 100.0  # of all effects together, for an effect to be there
    noteworthy_e_value: float = 2.0  # above which it cannot be told whether there is one
    substantial: float = 0.1  # share of the held-out excess that a name must surely remove, so that a recording is partly explained
    undecided: float = 0.05  # a set that has more than this share of the best one's probability is an alternative to it
    discrepancy: float = 0.02  # of its own displacement that an effect is wrong by, at each pose: no model is exact

    # Outliers
    gross_medians: float = 8.0  # distance, in medians, up to which a centre takes part in a search although geometry alone rejects it
    outlier_prior: float = 0.01  # share of grossly wrong centres
    outlier_mm: float = 1.0  # standard deviation of a grossly wrong centre
    outlier_rad: float = 0.01  # and of a grossly wrong orientation

    # Search
    beam: int = 3  # sets kept, and alternatives reported of an effect
    estimated: int = 5  # sets of a round that get a noise of their own, and effects that are tried in the place of one of the best set
    reach: float = 10.0  # log posterior odds to first order, against the best set, up to which a set is looked at more closely
    most_effects: int = 18  # of a set
    rounds: int = 12  # at most, of what is repeated until nothing changes within a linearisation
    passes: int = 2  # at most, of linearisations, and of exchanges of the best set's effects for others
    steady: float = 0.05  # change of a logarithm of the noise, or of a coefficient in standard deviations, below which an estimation ends
    fine: int = 33  # values of a hyper-parameter between two of its grid
    resolved: float = 1.0  # log Bayes factor by which a peak may be above its neighbours on a grid that resolves it

    # Basis functions of unmodelled effects
    smooth: int = 5  # functions over the range of a covariate: a line and cosines
    fading_reaches: tuple[float, ...] = (0.1, 0.3, 1.0)  # rad of travel over which lost motion fades: grease, wind-up, pre-sliding
    stiffness_powers: tuple[float, ...] = (1 / 3, 2 / 3, 2.0, 3.0)  # of the load: teeth in contact stiffen, what lifts off softens
    near_joints: int = 2  # on either side of a frame, whose angles in pairs a hose or a cable there may feel
    visits: tuple[float, ...] = (0.2, 1.5)  # poses after which the beginning of a visit has faded: the first one alone, the first few
    settles_s: tuple[float, ...] = (5.0, 60.0)  # after a pause: the first pose alone, and what brakes, grease and rubber take
    shortest_period_mm: float = 8.0  # of periodic errors in the field of view
    varies: float = 0.02  # rad, or of the largest: what varies by less counts as constant

    noticeable: float = 1.5  # factor by which a noise, or a variance of data left out, must be off to be spoken of


OPTIONS = DiagnosisOptions()
