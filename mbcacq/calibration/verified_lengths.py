"""Certified distances of a recording through an estimated cell, each with the uncertainty that the estimate predicts for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration import verification
from mbcacq.calibration.cell_estimate import CellEstimate, measuring_terms
from mbcacq.calibration.length_budget import length_budget
from mbcacq.calibration.verification import Verification
from mbcacq.estimation.forward_model import CellState
from mbcacq.model.observations import Observations


def verified_lengths(cell: CellEstimate, before: CellState, observations: Observations, limit_mm: float | None) -> Verification:
    """Sphere spacing errors at the verification poses of a recording.

    Parameters
    ----------
    cell
        The estimated cell.
    before
        The cell that the errors are compared with.
    observations
        The recording.
    limit_mm
        Largest error permitted, mm.

    Returns
    -------
    Verification
        Without figures, and without a statement on whether the poses took part in the calibration.
    """
    obs = verification.verification_poses(observations)
    pairs = verification.measured_pairs(obs, before, cell.state, cell.effects)
    if not pairs:
        return Verification(places=(), limit_mm=limit_mm)
    (qa, a, na), (qb, b, nb) = (verification.stacked([p.ends[k] for p in pairs]) for k in (0, 1))
    u, row = cell.distance_errors(qa, a, qb, b)
    ends = [_end_variance(cell, u, q, xyz, count) for q, xyz, count in ((qa, a, na), (qb, b, nb))]
    measuring = sum((seen + moved) / count for seen, moved, count in ends)
    expected = np.sqrt(np.sum(row**2, axis=1) + measuring)
    budgets = [length_budget(obs, p.station, p.pair.balls, [(s[i], m[i], n[i]) for s, m, n in ends]) for i, p in enumerate(pairs)]
    common = float(np.linalg.norm(row.mean(axis=0))) if len(pairs) > 1 else None
    found = verification.verification_of(pairs, budgets, limit_mm)
    places = tuple(replace(place, expected_mm=float(e)) for place, e in zip(found.places, expected, strict=True))
    return replace(found, places=places, common_mm=common)


def _end_variance(
    cell: CellEstimate, u: np.ndarray, q: np.ndarray, xyz: np.ndarray, count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Variances (P,) mm^2 along u (P, 3) of one measurement by the scanner and by the joints, and the numbers averaged over."""
    seen, moved = (np.einsum("pi,pij,pj->p", u, C, u) for C in measuring_terms(cell.state, cell.noise, q, xyz))
    return seen, moved, count
