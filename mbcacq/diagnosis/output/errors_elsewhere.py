"""What an effect would do at postures that the recording does not have: errors in the workspace and of lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.output.next_measurements import Elsewhere, SizedEffect

ROUNDED = 1e-10  # share of an effect's displacement below which what is left of it is rounding


def harmless(there: Elsewhere, effect: SizedEffect) -> bool:
    """Whether an effect displaces everything alike, as a constant sag does: no length shows it, nor suffers from it."""
    workspace, length = errors_elsewhere(there, replace(effect, coefficients=effect.candidate.typical))
    return workspace is not None and length is not None and length < ROUNDED * workspace


def errors_elsewhere(there: Elsewhere, effect: SizedEffect) -> tuple[float | None, float | None]:
    """Largest displacement (mm) over postures in the workspace, and the error of lengths between pairs of them that 95 % do not exceed.

    None for what the geometry absorbs, for effects over time, which no posture has, and for single balls or stations.
    """
    return errors_of(there, there.displacement(effect) if np.isfinite(effect.in_typical_sizes) else None)


def errors_of(there: Elsewhere, moved: np.ndarray | None) -> tuple[float | None, float | None]:
    """The same of displacements (P, 3) mm at these postures."""
    if moved is None or not np.any(moved):
        return None, None
    linear = there.linear
    T = linear.prediction.T_base_scanner if there.context.scanner_on_flange else linear.prediction.T_base_station
    in_base = np.einsum("pij,pj->pi", T[:, :3, :3], moved)
    position = linear.prediction.T_base_scanner[:, :3, 3]
    first, second = np.random.default_rng(0).integers(0, len(position), (2, len(position)))
    apart = position[first] - position[second]
    along = apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
    length = np.abs(np.sum((in_base[first] - in_base[second]) * along, axis=1))
    return float(np.linalg.norm(moved, axis=1).max()), float(np.quantile(length, 0.95))
