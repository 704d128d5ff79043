"""How much of the period of a periodic effect a recording covers."""

import numpy as np

LEAST_PERIODS = 1.0  # of an order that is only found, which the travel must cover for the claim that the error is periodic


def periods_covered(q: np.ndarray, order: float) -> float:
    """Periods of an order that the travel of a joint q (P,) rad covers."""
    return float(order * np.ptp(q) / (2 * np.pi))
