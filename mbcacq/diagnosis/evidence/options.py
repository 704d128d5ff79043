"""The numbers of the evidence criterion, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EvidenceOptions:
    """Prior weights, discrepancy of a model and effort of the search."""

    # Prior of effects
    sizes: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # of a coefficient's prior sigma, in typical sizes, equally probable
    further: float = 0.1  # prior probability of one more effect
    same_kind: float = 0.5  # share of that for more of a kind that is there already: many joints of an arm are of one make
    unmodelled: float = 0.01  # prior probability of an effect outside the catalogue, relative to one of the catalogue
    preferred: float = 0.8  # share of the preferred values of a hyper-parameter (the orders of a gear)
    # Noise alone is above e in at most 1/e of the recordings (Markov's inequality), and in fact in far fewer: above two in 4 of 1000 with
    # 50 poses and more, above ten in 2 of 1000 with fewer (benchmarks/recording_sizes.md).
    least_e_value: float = 2.0  # of all effects together, for an effect to be there
    short_recording: int = 50  # poses, below which few joint angles decide what is the joints' noise
    least_e_value_of_short: float = 10.0
    undecided: float = 0.05  # a set that has more than this share of the best one's probability is an alternative to it

    discrepancy: float = 0.02  # of its own displacement that an effect is wrong by, at each pose: no model is exact

    # Outliers
    outlier_prior: float = 0.01  # share of grossly wrong centres
    outlier_mm: float = 1.0  # standard deviation of a grossly wrong centre
    outlier_rad: float = 0.01  # and of a grossly wrong orientation

    # Search
    beam: int = 3  # sets kept
    compared: int = 8  # candidates of the catalogue, and unmodelled ones, that are proposed to extend a set
    estimated: int = 5  # sets of a round that get a noise of their own
    alternatives: int = 4  # of the catalogue in the place of an effect of the best set
    unmodelled_alternatives: int = 2  # and unmodelled ones
    reach: float = 10.0  # log posterior odds to first order, against the best set, up to which a set is looked at more closely
    most_effects: int = 18  # of a set
    rounds: int = 8  # of the estimation of the noise of a set
    relinearizations: int = 2


OPTIONS = EvidenceOptions()
