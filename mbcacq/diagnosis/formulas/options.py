"""The numbers of the search for formulas, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FormulaOptions:
    """Prior of formulas and effort of their search; ``benchmarks/formulas.md`` measures all of it together."""

    # Dictionary
    orders: int = 4  # periods a turn of any joint's angle
    own_orders: int = 9  # and of the angle of the joint at, or before, the location, as the evidence map has it
    product_orders: int = 2  # periods a turn in a product with something else
    waves: int = 48  # half periods over the field of view, of a periodic error of the scanner, in steps of a half
    fading: tuple[float, ...] = (0.08, 0.2, 0.5)  # time constants, in durations of the recording

    # Prior
    products: float = 0.4  # share of the terms that are products of two covariates
    located: float = 0.5  # share of the terms with the covariate that the diagnosis found
    further: float = 0.1  # prior probability of one more term
    odds: float = 0.05  # a location of more than this share of the best one's probability is searched too

    # Search
    most_terms: int = 3  # of a formula
    most_coefficients: int = 12  # of a term: more are no short formula
    beam: int = 4  # formulas that are extended
    compared: int = 8  # extensions of a formula that are compared to first order
    estimated: int = 8  # formulas whose noise is estimated anew
    estimated_of_each: int = 3  # and at least so many of each number of terms
    proposed: int = 3  # formulas that are reported
    folds: int = 4  # parts of the data without which the search is repeated
    least_log_odds: float = 3.0  # posterior odds against no formula: twenty to one


OPTIONS = FormulaOptions()
