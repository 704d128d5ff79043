"""What the uncertainty of a scale from one known length adds to that of the hand-eye transform.

Measurements were multiplied so that the length comes out as known. The factor is as uncertain as the length and as its mean over the scans;
the transform follows it, and by how much is seen from a second adjustment with all lengths a little larger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.scan_scale import known_length_sigma
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations

LEAST_STEP = 1e-5  # relative; below, rounding would show
TWIST = ("x", "y", "z", "rx", "ry", "rz")


def with_length_uncertainty(result: CalibratedCell, refitted: Callable[[Observations], CellState]) -> CalibratedCell:
    """The result with the covariances of the hand-eye transform and the stations enlarged; as it is without a known length.

    refitted: the state of the cell from observations, under the same options.
    """
    obs = result.fit.observations
    sigma = known_length_sigma(obs)
    if sigma is None:
        return result
    step = max(sigma, LEAST_STEP)
    artefacts = tuple(a if a.certified else replace(a, centres=(1 + step) * a.centres) for a in obs.cell.artefacts)
    larger = refitted(replace(obs, xyz=(1 + step) * obs.xyz, cell=replace(obs.cell, artefacts=artefacts)))
    by_scale = np.zeros(len(result.names))
    twist = _twist(result.state.T_flange_scanner, larger.T_flange_scanner) * sigma / step
    for name, value in zip((f"hand_eye.{part}" for part in TWIST), twist, strict=True):
        if name in result.names:
            by_scale[result.names.index(name)] = value
    stations = result.fit.station_covariance.copy()
    for s in np.flatnonzero(np.einsum("sii->s", stations) > 0):
        moved = _twist(result.state.T_base_station[s], larger.T_base_station[s]) * sigma / step
        stations[s] += np.outer(moved, moved)
    fit = replace(result.fit, station_covariance=stations)
    return replace(result, covariance=result.covariance + np.outer(by_scale, by_scale), own_fit=fit)


def _twist(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(6,) mm and rad behind ``before`` that leads to ``after``."""
    off = se3.inverse(before) @ after
    return np.r_[off[:3, 3], se3.rotation_log(off[:3, :3])]
