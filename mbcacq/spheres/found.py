"""What sphere extraction returns, and what may be adjusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mbcacq.quantities import DEGREE
from mbcacq.spheres.fit import SphereFit

ROUGHNESS = 9.0  # times the noise of a centre: as the default's 0.08 mm to the 0.009 mm of the scanners it was chosen for
CREDIBLE_SIGMAS = 6.0  # of a centre against its certificate: far in the tail of a normal distribution
Refusals = list[tuple[str, np.ndarray | None]]  # reason and centre


@dataclass(frozen=True, kw_only=True)
class SphereOptions:
    """Limits of sphere extraction. Lengths mm, angles rad.

    Attributes
    ----------
    max_incidence : float
        Points whose surface normal is further from the line of sight are omitted (grazing, edge and mixed points).
    max_noise : float
        Largest credible noise of a point along the normal.
    min_points, min_coverage
        A ball with fewer points, or less of the cap up to ``max_incidence`` covered, is refused.
    radius_tolerance : float
        Relative; how far the freely fitted radius may be off.
    centre_tolerance : float
        How far a ball may be from its certified position and still be recognised.
    scale_tolerance : float
        Relative; the same for all lengths together (scanner scale, temperature).
    centre_sigma : float
        Systematic part of a centre's uncertainty, for telling two assignments apart.
    view : tuple[float, float, float] or None
        (3,) direction from the balls to the scanner, or None to take it from the data.
    """

    max_incidence: float = 65.0 * DEGREE
    max_noise: float = 0.08
    min_points: int = 60
    min_coverage: float = 0.25
    radius_tolerance: float = 0.01
    centre_tolerance: float = 0.25
    scale_tolerance: float = 1.5e-3
    centre_sigma: float = 0.01
    view: tuple[float, float, float] | None = None

    @classmethod
    def for_noise(cls, noise_mm: Sequence[float] | None) -> SphereOptions:
        """Limits for a scanner whose centres scatter by noise_mm (3,): the roughness it causes is no fault of the ball."""
        if noise_mm is None:
            return cls()
        noise, usual = max(noise_mm), cls()
        tolerance, most = max(usual.centre_tolerance, CREDIBLE_SIGMAS * noise), max(usual.max_noise, ROUGHNESS * noise)
        return cls(max_noise=most, centre_tolerance=tolerance, centre_sigma=max(usual.centre_sigma, noise))


@dataclass(frozen=True, kw_only=True)
class FoundSpheres:
    """Balls recognised in one cloud, in the order of the certificate.

    Attributes
    ----------
    ball : ndarray
        (k,) certificate ids.
    xyz : ndarray
        (k, 3) float64 mm, scanner frame.
    n_points : ndarray
        (k,) points that carried the fit.
    rms_mm : ndarray
        (k,) of their distances to the sphere.
    covariance : ndarray
        (k, 3, 3) mm^2 of each centre, from the fit.
    radius_error_mm : ndarray
        (k,) freely fitted minus certified radius.
    refused : list[tuple[str, ndarray or None]]
        (reason, centre) of what looked like a ball and was not used; the centre is (3,) mm, or None if it has none.
    """

    ball: np.ndarray
    xyz: np.ndarray
    n_points: np.ndarray
    rms_mm: np.ndarray
    covariance: np.ndarray
    radius_error_mm: np.ndarray
    refused: Refusals = field(default_factory=list)

    @classmethod
    def of(cls, balls: Sequence[int] = (), fits: Sequence[SphereFit] = (), refused: Refusals | None = None) -> FoundSpheres:
        """Balls of these certificate ids, each with its fit; none of them, as in a scan of a part."""
        return cls(
            ball=np.array(balls, dtype=int),
            xyz=np.array([f.centre for f in fits]).reshape(-1, 3),
            n_points=np.array([f.n_points for f in fits], dtype=int),
            rms_mm=np.array([f.rms_mm for f in fits]),
            covariance=np.array([f.covariance for f in fits]).reshape(-1, 3, 3),
            radius_error_mm=np.array([f.radius_error for f in fits]),
            refused=refused or [],
        )

    def __len__(self) -> int:
        return len(self.ball)
