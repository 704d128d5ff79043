"""How much of the catalogue a recording excludes, and the number of poses like its own that would exclude enough.

That nothing was found means something only where something could have been. Every kind of effect counts alike, every location of a kind
too, as in their prior probability.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.output.exclusion_limits import LimitedEffect

ENOUGH = 0.5  # share of the effects that a verdict ``none`` excludes at their typical size
MOST_POSES = 1000  # a plan of more poses is no advice: another one is needed


def excluded_share(limited: Sequence[LimitedEffect]) -> float:
    """Share of the effects whose exclusion limit is below their typical size; 1 where there is none."""
    weight = weights(limited)
    below = np.array([e.in_typical_sizes <= 1.0 for e in limited], dtype=bool)
    return float(weight[below].sum()) if len(limited) else 1.0


def sufficient_poses(limited: Sequence[LimitedEffect], poses: int) -> int | None:
    """Number of poses like the ``poses`` of the recording at which enough effects would be excluded; None where no number is enough.

    Limits fall with 1 / sqrt(number of poses) where each further pose repeats one of the recording, and faster where it does not.
    """
    if excluded_share(limited) >= ENOUGH:
        return poses
    sizes = np.array([e.in_typical_sizes for e in limited])
    ranked = np.argsort(sizes, kind="stable")
    last = ranked[min(int(np.searchsorted(np.cumsum(weights(limited)[ranked]), ENOUGH - 1e-9)), len(ranked) - 1)]
    return int(np.ceil(poses * sizes[last] ** 2)) if np.isfinite(sizes[last]) else None


def weights(limited: Sequence[LimitedEffect]) -> np.ndarray:
    """(E,) of each effect, of sum one."""
    locations = Counter(e.candidate.name for e in limited)
    return np.array([1.0 / (len(locations) * locations[e.candidate.name]) for e in limited])


def says_too_little(limited: Sequence[LimitedEffect], poses: int) -> str | None:
    """A sentence where the recording excludes too little for a verdict ``none``."""
    share = excluded_share(limited)
    if share >= ENOUGH:
        return None
    said = f"of the effects of the catalogue {share:.0%} are excluded at their typical size, less than half"
    enough = sufficient_poses(limited, poses)
    if enough is None or enough > MOST_POSES:
        return f"{said}, and more poses like these would not exclude half of them: measure other postures"
    return f"{said}: {enough} poses like these, instead of {poses}, would exclude half of them"
