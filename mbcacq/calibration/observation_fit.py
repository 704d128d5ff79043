"""How the observations of a recording fit a calibrated cell, and what a calibration says of each of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np

from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.estimation import parameters
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.identifiability import Undetermined, correlated_pairs
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import Solution, covariance_of, covariance_under_its_noise
from mbcacq.estimation.terms import Term, known_errors
from mbcacq.geometry import se3
from mbcacq.model.json_text import EveryKey
from mbcacq.model.observations import Observations

CORRELATED = 0.95

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


@dataclass(frozen=True)
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

    def instrument_errors(self, observations: Observations) -> list[tuple[Term, np.ndarray]]:
        """The errors of the instrument that belong to the recording, as terms of other poses of it, with their estimates."""
        # The coefficients of a discrepancy stand behind those of the terms that were asked for.
        terms = zip(self.options.terms, self.coefficients, strict=False)
        return known_errors(observations, {name: float(v) for t, c in terms for name, v in zip(t.names, c, strict=True)})

    def holds(self, observations: Observations) -> bool:
        """Whether any pose of ``observations`` is among those fitted: the same number with the same joint angles."""
        mine = {int(n): q for n, q in zip(self.observations.pose_id, self.observations.q, strict=True)}
        return any(int(n) in mine and np.array_equal(mine[int(n)], q) for n, q in zip(observations.pose_id, observations.q, strict=True))


def adjusted_fit(options: CalibrationOptions, adjustment: Adjustment, known_noise: bool = False) -> tuple[ObservationFit, CellEstimate]:
    """The fit of the observations that were adjusted, and the cell that it estimates.

    Parameters
    ----------
    options : CalibrationOptions
        Under which the observations were adjusted.
    adjustment : Adjustment
        Converged.
    known_noise : bool
        Whether the noise is known before the recording, not estimated by it.
    """
    lineariser, solution, weights = adjustment.lineariser, adjustment.solution, adjustment.weights
    obs, layout, normal = lineariser.obs, lineariser.layout, solution.normal
    C = covariance_under_its_noise(solution) if known_noise else covariance_of(solution)
    alike = correlated_pairs(layout.names, C, CORRELATED)
    station_covariance = np.zeros((len(obs.cell.stations), 6, 6))
    station_covariance[lineariser.rows.stations] = normal.station_covariance(C)
    rank = layout.size + int(normal.station_rank.sum())
    solution.forget()  # the whitened residual of a long recording takes as much memory as what it no longer needs
    fit = ObservationFit(
        observations=obs,
        options=options,
        coefficients=solution.estimate.coefficients,
        station_covariance=station_covariance,
        weights=weights,
        residual=solution.residual,
        whitened=solution.whitened_residual,
        chi2=solution.cost,
        dof=int(adjustment.used.sum()) * lineariser.rows.width + solution.prior.rows - rank,
        rank=rank,
        iterations=solution.iterations,
    )
    alike = tuple(one for one in alike if not any(name.startswith("unknown:") for name in one[:2]))
    fit = replace(fit, undetermined=tuple(adjustment.found), rejected=_rejected(obs, solution, weights), correlated=alike)
    return fit, CellEstimate(state=solution.estimate.state, layout=layout, covariance=C, noise=adjustment.noise)


def _rejected(obs: Observations, solution: Solution, weights: Weights) -> tuple[Rejected, ...]:
    size = np.linalg.norm(solution.residual[:, :3], axis=1)
    out = [
        Rejected(pose=int(obs.pose_id[p]), distance_mm=float(size[obs.pose == p].max(initial=0.0)))
        for p in np.flatnonzero(weights.pose == 0)
    ]
    single = np.flatnonzero((weights.centre == 0) & (weights.pose[obs.pose] > 0))
    return (
        *out,
        *(Rejected(pose=int(obs.pose_id[obs.pose[m]]), ball=obs.cell.ball_ids[obs.ball[m]], distance_mm=float(size[m])) for m in single),
    )


def parameters_of(fit: ObservationFit, layout: ParameterLayout, state: CellState, covariance: np.ndarray) -> list[Parameter]:
    """Every parameter of a fit, blocks in order; balls have only their free ones."""
    cell, T = fit.observations.cell, state.T_flange_scanner
    turn = se3.rotation_log((se3.inverse(cell.T_flange_scanner) @ T)[:3, :3])
    mount, moved = np.concatenate([T[:3, 3], turn]), np.concatenate([T[:3, 3] - cell.T_flange_scanner[:3, 3], turn])
    values = [state.chain.rows.reshape(-1), mount, state.balls.reshape(-1), *fit.coefficients]
    arm, balls = state.chain.rows - cell.robot.chain.rows, state.balls - cell.ball_centres
    errors = [arm.reshape(-1), moved, balls.reshape(-1), *fit.coefficients]
    std = iter(_standard_deviations(layout.names, T, covariance))
    of_arm, out = fit.options.kinematics, []
    for block, value, error in zip(layout.blocks, values, errors, strict=True):
        for i, name in enumerate(block.names):
            if block.free[i] or name in block.why:
                about = {"status": _status(block, i, of_arm), "reason": block.why.get(name, ""), **_prior(block, i, of_arm)}
                sigma = next(std) if block.free[i] else None
                out.append(Parameter(name=name, value=float(value[i]), error=float(error[i]), unit=block.units[i], std=sigma, **about))
    return out


def _standard_deviations(names: Sequence[str], T_flange_scanner: np.ndarray, covariance: np.ndarray) -> list[float]:
    """Standard deviations of the free parameters; the hand-eye translation along the flange's axes."""
    C = covariance.copy()
    hand_eye = [names.index(f"hand_eye.{c}") for c in "xyz" if f"hand_eye.{c}" in names]
    if len(hand_eye) == 3:
        R = T_flange_scanner[:3, :3]
        block = np.ix_(hand_eye, hand_eye)
        C[block] = R @ C[block] @ R.T
    return np.sqrt(np.diag(C)).tolist()


def _status(block: parameters.ParameterBlock, i: int, identified: bool) -> Status:
    if not block.free[i]:
        return "held"
    if block.name == "chain" and block.group is not None and not identified:
        return "marginal"
    return "prior" if np.isfinite(block.sigma[i]) else "free"


def _prior(block: parameters.ParameterBlock, i: int, identified: bool) -> dict[str, float]:
    """Standard deviation and mean of the prior of a parameter's error, where one was used."""
    if _status(block, i, identified) != "prior":
        return {}
    return {"prior_std": float(block.sigma[i]), "prior_mean": 0.0 if block.centre is None else float(block.centre[i])}
