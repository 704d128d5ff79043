"""How far the artefact leans away from the scanner, at each pose."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context


def artefact_tilt(s: Context) -> np.ndarray:
    """(P,) rad between the scanner's axis and the artefact's z."""
    scanner, station = s.prediction.T_base_scanner[:, :3, 2], s.prediction.T_base_station[:, :3, 2]
    return np.arccos(np.clip(np.abs(np.sum(scanner * station, axis=1)), 0, 1))
