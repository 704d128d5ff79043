"""The scanner's scale, from the distances of balls within single scans against the certificate.

A calibration cannot observe a scale common to all scans: the arm's lengths and the hand-eye translation grow with it, and every distance
it measures later is wrong by that share. The scans themselves show it, whatever the arm did.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import computed_field

from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE, Cell
from mbcacq.model.observations import Observations

CLEAR = 3.0
FEW = 8  # scans from whose own scatter their mean is judged; with fewer, by the noise


@dataclass(frozen=True)
class ScanScale:
    """ppm: by how much distances within a scan are longer than certified; sigma_ppm: standard uncertainty, of which certificate_ppm is
    the certificates' and does not fall with more scans; scans: how many took part."""

    ppm: float
    sigma_ppm: float
    certificate_ppm: float
    scans: int

    @computed_field
    @property
    def significant(self) -> bool:
        """Beyond three standard uncertainties."""
        return abs(self.ppm) > CLEAR * self.sigma_ppm


def scan_scale(obs: Observations, used: np.ndarray, noise_mm: np.ndarray) -> ScanScale | None:
    """From the centres where ``used`` (M,) bool holds; noise_mm: (3,) of one centre. None if no scan shows two balls of an artefact."""
    if obs.cell.measurement == TARGET_IN_BASE:
        return None
    certified = [a for a, artefact in enumerate(obs.cell.artefacts) if artefact.certified]
    parts = [part for a in certified if (part := _of_artefact(obs, used, a, float(np.mean(noise_mm)))) is not None]
    if not parts:
        return None
    ppm, scatter, certificate, count = np.array(parts).T
    weight = 1 / (scatter**2 + certificate**2)
    weight /= weight.sum()
    from_certificates = float(np.sqrt(np.sum((weight * certificate) ** 2)))
    total = float(np.sqrt(np.sum(weight**2 * (scatter**2 + certificate**2))))
    return ScanScale(float(np.sum(weight * ppm)), total, from_certificates, int(count.sum()))


def known_length_sigma(obs: Observations) -> float | None:
    """Standard uncertainty (relative) of a scale that was taken from one known length: that of the length, and that of its mean over the
    scans, from their scatter. None if the scale is not from a known length."""
    known = next((a.known_length for a in obs.cell.artefacts if a.known_length is not None), None)
    if known is None or obs.scale is None:
        return None
    mean, sigma = measured_length(obs, known.balls)
    return float(np.hypot(known.uncertainty_mm / known.length_mm, sigma / mean)) if mean > 0 else None


def measured_length(obs: Observations, balls: tuple[int, int]) -> tuple[float, float]:
    """Mean distance (mm) of two balls over the scans that show both, and its standard uncertainty from their scatter (0 of one scan);
    0, 0 where no scan shows both."""
    a, b = (obs.ball == obs.cell.ball_ids.index(ball) for ball in balls)
    both, of_a, of_b = np.intersect1d(obs.pose[a], obs.pose[b], return_indices=True)
    if not len(both):
        return 0.0, 0.0
    lengths = np.linalg.norm(obs.xyz[a][of_a] - obs.xyz[b][of_b], axis=1)
    scatter = float(np.std(lengths, ddof=1)) if len(both) > 1 else 0.0
    return float(lengths.mean()), scatter / np.sqrt(len(both))


def scale_in_words(obs: Observations) -> str:
    """Whose scale the calibrated cell has, where an artefact is not certified; '' if all are."""
    unknown = [a for a in obs.cell.artefacts if not a.certified]
    if not unknown:
        return ""
    lengths = [a.known_length for a in unknown if a.known_length is not None]
    if not lengths or obs.scale is None:
        return "the instrument's own; no length of the artefact is certified"
    ppm, known = 1e6 * (obs.scale - 1), lengths[0]
    sigma = 1e6 * (known_length_sigma(obs) or known.uncertainty_mm / known.length_mm)
    return (
        f"that of the known length of balls {known.balls[0]} and {known.balls[1]} ({known.length_mm:g} mm, ± {2 * sigma:.0f} ppm, k = 2); "
        "all that was "
        f"measured was multiplied by 1 {ppm:+.0f} ppm; multiply what you place with this result in the same way"
    )


def _of_artefact(obs: Observations, used: np.ndarray, a: int, noise: float) -> tuple[float, float, float, int] | None:
    """Scale, its scatter, its uncertainty by the certificate, all in ppm, and the number of scans, of one artefact."""
    cell: Cell = obs.cell
    rows = used & (cell.ball_artefact[obs.ball] == a)
    rows &= (np.bincount(obs.pose[rows], minlength=obs.n_poses) > 1)[obs.pose]
    if not rows.any():
        return None
    poses, group = np.unique(obs.pose[rows], return_inverse=True)
    known, measured = cell.ball_centres[obs.ball[rows]], obs.xyz[rows]
    rotation = se3.fit_rigid_transforms(known, measured, group, len(poses))[:, :3, :3]
    known, measured = _centred(known, group), _centred(measured, group)
    size = np.bincount(group, np.sum(known**2, axis=1))
    scale = np.bincount(group, np.sum(measured * np.einsum("mij,mj->mi", rotation[group], known), axis=1)) / size - 1
    mean = float(np.average(scale, weights=size))
    by_noise = noise / np.sqrt(size.sum())
    scatter = np.sqrt(np.average((scale - mean) ** 2, weights=size) / (len(poses) - 1)) if len(poses) >= FEW else by_noise
    certificate = cell.artefacts[a].uncertainty_mm / np.sqrt(size.mean())
    return 1e6 * mean, 1e6 * float(scatter), 1e6 * float(certificate), len(poses)


def _centred(points: np.ndarray, group: np.ndarray) -> np.ndarray:
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, points[:, c]) for c in range(3)], axis=1) / count[:, None]
    return points - mean[group]
