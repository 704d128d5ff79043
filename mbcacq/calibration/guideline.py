"""Verification after the manner of VDI/VDE 2634 Part 3: probing error (form and size), sphere spacing error, length measuring error.

"After the manner of", because that guideline speaks of optical measuring systems by themselves and excludes sensors that are
positioned by axes; the quantities are formed as it forms them, on places and balls of the verification poses. A limit is held against
each figure with the uncertainty of measuring it in mind: pass only where it keeps clear of it, fail only where it clearly exceeds it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from mbcacq.calibration.result import Calibration
from mbcacq.calibration.verification import verification_poses, verify
from mbcacq.geometry import se3
from mbcacq.observations import Observations

CLEAR = 1.645   # one-sided 95 %


@dataclass(frozen=True)
class Limits:
    """Largest permitted errors in mm; None: not judged."""

    sphere_spacing_error_mm: float | None = None
    probing_error_form_mm: float | None = None
    probing_error_size_mm: float | None = None
    length_measuring_error_mm: float | None = None


@dataclass(frozen=True)
class Figure:
    """value_mm: largest of ``count`` values; uncertainty_mm: standard uncertainty of measuring it (the certificate's), None if unknown;
    verdict: 'pass', 'fail', 'undecided' (within the uncertainty of the limit) or 'none' (no limit or no data)."""

    name: str
    value_mm: float | None
    count: int
    uncertainty_mm: float | None
    limit_mm: float | None
    verdict: str

    def to_dict(self) -> dict:
        return asdict(self)


def judge(observations: Observations, calibration: Calibration, limits: Limits | None = None,
          spacing: np.ndarray | None = None) -> list[Figure]:
    """The four figures, from the verification poses (where there are none, only what can be said is said).

    Form: the range of distances from the fitted sphere cannot be had from centres; four times the rms of the fits (95 % of a normal
    distribution) stands for it. Size: needs measured diameters, which an observation set does not hold. Length: largest error
    between two balls of one station, over every pair of single scans, so that repeats do not average.
    """
    limits = limits or Limits()
    obs = verification_poses(observations)
    spacing = verify(observations, calibration).errors("after") if spacing is None else spacing
    sigma = certificate_sigma(obs)
    form = 4 * float(np.nanmax(obs.rms_mm)) if obs.rms_mm is not None and obs.n_centres and np.any(np.isfinite(obs.rms_mm)) else None
    points = 0.0 if obs.n_points is None or not obs.n_centres else float(np.min(obs.n_points))
    form_sigma = form / np.sqrt(2 * points) if form is not None and points > 1 else None
    lengths = single_lengths(obs, calibration)
    return [
        _figure("sphere spacing error", spacing, sigma, limits.sphere_spacing_error_mm),
        _figure("probing error, form (4 sigma of the sphere fits)", np.array([]) if form is None else np.array([form]), form_sigma,
                limits.probing_error_form_mm),
        _figure("probing error, size", np.array([]), None, limits.probing_error_size_mm),
        _figure("length measuring error (every pair of scans)", lengths, sigma, limits.length_measuring_error_mm),
    ]


def certificate_sigma(obs: Observations) -> float | None:
    """Standard uncertainty (mm) of a certified distance of the artefacts verified on."""
    used = {obs.cell.stations[s].artefact for s in np.unique(obs.station)}
    return max((np.sqrt(2) * obs.cell.artefact(a).uncertainty_mm for a in used), default=None)


def single_lengths(obs: Observations, calibration: Calibration) -> np.ndarray:
    """(K,) mm errors of the distance of two different balls of a station, for every pair of single measurements."""
    state = calibration.state
    base = se3.apply((state.chain.flange(obs.q) @ state.T_flange_scanner)[obs.pose], obs.xyz)
    station, certified = obs.station[obs.pose], obs.cell.ball_centres
    out = []
    for s in np.unique(station):
        rows = np.flatnonzero(station == s)
        i, j = np.triu_indices(len(rows), 1)
        a, b = rows[i], rows[j]
        keep = obs.ball[a] != obs.ball[b]
        a, b = a[keep], b[keep]
        out.append(np.linalg.norm(base[a] - base[b], axis=1) - np.linalg.norm(certified[obs.ball[a]] - certified[obs.ball[b]], axis=1))
    return np.concatenate(out) if out else np.array([])


def verdict(value: float | None, sigma: float | None, limit: float | None) -> str:
    """'pass', 'fail', 'undecided' or 'none', by one-sided 95 % on either side of the limit (after ISO 14253-1)."""
    if value is None or limit is None:
        return "none"
    margin = CLEAR * (sigma or 0.0)
    if value <= limit - margin:
        return "pass"
    return "fail" if value > limit + margin else "undecided"


def _figure(name: str, values: np.ndarray, sigma: float | None, limit: float | None) -> Figure:
    value = float(np.abs(values).max()) if len(values) else None
    return Figure(name, value, len(values), sigma, limit, verdict(value, sigma, limit))
