"""How the observations of a recording fit a calibrated cell, and what a calibration says of each of its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from mbcacq.estimation.identifiability import Undetermined
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.outliers import Weights
from mbcacq.model.json_text import EveryKey
from mbcacq.model.observations import Observations

Status = Literal["free", "prior", "marginal", "held"]


@dataclass(frozen=True, kw_only=True)
class Parameter(EveryKey):
    """One parameter of a calibrated cell.

    Attributes
    ----------
    value : float
        As the model uses it (hand-eye rotation: rotation vector of the change since the first guess).
    error : float
        Value minus nominal.
    status : Status
        'free', 'prior', 'marginal' or 'held'. 'prior' is free within a certificate, or within the common size of such errors. For
        'marginal' the nominal value stays; std says by how much it may be off, and every other uncertainty takes this into account. For
        'held' reason says why, and std is None.
    prior_std, prior_mean
        Standard deviation and mean of the error's prior, if a prior was used.
    """

    left_out = ("reason", "prior_std", "prior_mean")

    name: str
    value: float
    error: float
    unit: str
    std: float | None
    status: Status
    reason: str = ""
    prior_std: float | None = None
    prior_mean: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Rejected(EveryKey):
    """A measurement that was rejected as an outlier. pose: number as recorded; ball: certificate id, or None for the whole pose."""

    left_out = ("ball",)

    pose: int
    ball: int | None = None
    distance_mm: float


@dataclass(frozen=True)
class EstimatedNoise(EveryKey):
    """Standard deviations. scanner_mm: (3,) of a centre along the instrument's axes; joint_rad: (n,) repeatability of each axis; turn_rad:
    of a measured orientation about each axis, None where none was measured."""

    left_out = ("turn_rad",)

    scanner_mm: tuple[float, float, float]
    joint_rad: tuple[float, ...]
    turn_rad: float | None = None

    @classmethod
    def of(cls, noise: Noise, *, oriented: bool) -> Self:
        """oriented: whether orientations were measured."""
        return cls(tuple(noise.point.tolist()), tuple(noise.joint.tolist()), noise.turn if oriented else None)

    @property
    def noise(self) -> Noise:
        """As the estimation takes it."""
        point, joint = np.array(self.scanner_mm, dtype=float), np.array(self.joint_rad, dtype=float)
        return Noise(point, joint) if self.turn_rad is None else Noise(point, joint, self.turn_rad)


@dataclass(frozen=True, kw_only=True)
class ObservationFit:
    """The observations that a cell was calibrated from, with their residuals and weights.

    Attributes
    ----------
    observations : Observations
        M centres at P poses; verification poses and exact copies are not among them.
    options : CalibrationOptions
        Under which they were fitted, with the terms that were fitted with the geometry.
    coefficients : tuple of ndarray
        One (k,) array for each of these terms.
    station_covariance : ndarray
        (S, 6, 6) of the stations' local twists (mm, rad), zero where a station is unused.
    weights : Weights
        0 where a centre or a pose was rejected.
    residual, whitened : ndarray
        (M, R) mm (and rad), measured minus predicted; and the same of unit variance.
    chi2, dof, rank : float, int, int
        Figures of the fit; the rank is that of the free parameters and stations together.
    iterations : int
        Number of iterations of the solver.
    undetermined : tuple of Undetermined
        Parameters that the poses leave open, and that were held.
    rejected : tuple of Rejected
        Outliers.
    correlated : tuple
        (name, name, correlation) of pairs that the data can hardly separate.
    """

    observations: Observations
    options: CalibrationOptions
    coefficients: tuple[np.ndarray, ...]
    station_covariance: np.ndarray
    weights: Weights
    residual: np.ndarray
    whitened: np.ndarray
    chi2: float
    dof: int
    rank: int
    iterations: int
    undetermined: tuple[Undetermined, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    correlated: tuple[tuple[str, str, float], ...] = ()

    @property
    def used(self) -> np.ndarray:
        """(M,) bool: centres that took part."""
        return (self.weights.centre > 0) & (self.weights.pose[self.observations.pose] > 0)

    @property
    def oriented(self) -> bool:
        """Whether orientations were measured, and not points alone."""
        return self.residual.shape[1] == 6

    @property
    def used_stations(self) -> np.ndarray:
        """Indices of the stations of which a centre took part."""
        return np.unique(self.observations.station[self.observations.pose[self.used]])

    @property
    def used_poses(self) -> int:
        """Number of poses of which a centre took part."""
        return len(np.unique(self.observations.pose[self.used]))

    @property
    def rms_mm(self) -> float:
        """3D rms of the residuals of all centres used."""
        return float(np.sqrt(np.mean(np.sum(self.residual[self.used, :3] ** 2, axis=1)))) if self.used.any() else float("nan")

    def holds(self, observations: Observations) -> bool:
        """Whether any pose of ``observations`` is among those fitted: the same number with the same joint angles."""
        mine = {int(n): q for n, q in zip(self.observations.pose_id, self.observations.q, strict=True)}
        return any(int(n) in mine and np.array_equal(mine[int(n)], q) for n, q in zip(observations.pose_id, observations.q, strict=True))
