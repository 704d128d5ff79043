"""The numbers of the search for formulas, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FormulaOptions:
    """Dictionary of formulas and effort of their search; ``benchmarks/formulas.md`` measures all of it together."""

    least_range: float = 0.02  # of a covariate, in its unit (rad, s, K, N m, mm): one that varies less is a constant with noise
    product_orders: int = 2  # periods a turn in a product with something else
    fading: tuple[float, ...] = (0.08, 0.2, 0.5)  # time constants, in durations of the recording
    most_terms: int = 3  # of a formula
    proposed: int = 3  # formulas that are reported
    scatters: float = 2.0  # standard deviations of the difference of squares, up to which a formula predicts as well as the smooth model
    most_searches: float = 0.5  # share of the searches without a part of the data, more than which must find a formula again


OPTIONS = FormulaOptions()
