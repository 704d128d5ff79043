"""What the shares of the mismatch add up to, and why not to all of it."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq.diagnosis.result import MismatchEntry
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore

ROUNDING = 0.02  # of a sum of shares that are printed in per cent


def sum_of_shares(mismatch: Sequence[MismatchEntry], before: PredictiveScore, after: PredictiveScore) -> list[str]:
    """A sentence where the shares do not add up to 100 %.

    The share of a place is what only this place explains: what several explain alike is in no share, and places that compensate each other
    have more than they explain together. before, after: scores on the data of the fit, with geometry alone and with everything found.
    """
    if not mismatch:
        return []
    total = sum(m.share for m in mismatch)
    explained = min(max((before.chi2 - after.chi2) / max(before.chi2 - before.dof, 1e-9), 0.0), 1.0)
    said = []
    if explained > total + ROUNDING:
        said.append(f"another {explained - total:.0%} is explained by several places alike")
    elif total > explained + ROUNDING:
        said.append(f"together they explain {explained:.0%}, since some compensate others" if explained > ROUNDING else "none is proven")
    if explained < 1 - ROUNDING:
        said.append(f"{1 - explained:.0%} is not explained")
    return [f"the shares add up to {total:.0%}: {', '.join(said)}"] if said else []
