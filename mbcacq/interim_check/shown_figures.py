"""What the page of a check shows besides its verdict: how far each check lies from the first one, and the limit of that."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtri

from mbcacq.interim_check.history import CheckHistory
from mbcacq.interim_check.planned_check import PlannedCheck
from mbcacq.interim_check.verdict import CheckVerdict, evidence_of
from mbcacq.interim_check.words import size_in_words, size_of

WITHIN = 0.9973  # of the differences of a cell in which nothing changed lie below the control limit


def differences(planned: PlannedCheck, history: CheckHistory, verdict: CheckVerdict) -> tuple[list[float], float]:
    """Root mean square distance (mm) of the centres of each check from those of the first one, and its control limit.

    The limit is a quantile of a quadratic form of normal differences, by Satterthwaite's two moments (Biometrics Bulletin 2, 1946): noise
    and the usual changes from day to day, twice, at the levels of the verdict.
    """
    evidence = evidence_of(planned, history)
    rows, centres = evidence.process.rows, evidence.days.shape[1] / 3
    covariance = 2 * (verdict.noise**2 * rows.noise + verdict.day**2 * rows.daily @ rows.daily.T)
    mean, square = float(np.trace(covariance)), float(np.sum(covariance**2))
    freedom = mean**2 / square
    limit = np.sqrt(mean * chdtri(freedom, 1 - WITHIN) / freedom / centres)
    return [float(np.sqrt(np.sum((day - evidence.days[0]) ** 2) / centres)) for day in evidence.days], float(limit)


def shown(planned: PlannedCheck, history: CheckHistory, verdict: CheckVerdict) -> dict[str, Any]:
    """What the page shows besides the verdict's own fields."""
    by_check, limit = differences(planned, history, verdict)
    return {
        "robot": planned.obs.cell.robot.name,
        "plan": history.plan,
        "poses": list(history.poses),
        "times": [day.time for day in history.days],
        "log_e_since_calibration_by_check": [day.log_e_calibration or 0.0 for day in history.days],
        "difference_mm": by_check,
        "difference_limit_mm": limit,
        "suspects_in_words": [(s.label, f"{s.probability:.2f}", size_of(s)) for s in verdict.suspects],
        "noticed_in_words": [(f"{name} ({where})", size_in_words(size, 0.0, unit)) for name, where, size, unit in verdict.noticed],
    }
