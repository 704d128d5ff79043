"""The adjusted cell with its covariance, residuals and weights; every figure of a calibration is computed from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.identifiability import Undetermined
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import ParameterBlock, ParameterLayout
from mbcacq.estimation.solver import Solution, Weights
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.model.observations import Observations

CORRELATED = 0.95


@dataclass(frozen=True)
class Parameter:
    """value: as the model uses it (hand-eye rotation: rotation vector of the change since the first guess). error: value minus nominal.
    status: 'free', 'prior' (free within a certificate, or within the common size of such errors), 'marginal' (the nominal value stays; std
    says by how much it may be off, which every other uncertainty takes into account) or 'held' (reason says why; std is None). prior_std,
    prior_mean: of the error, where a prior was used."""

    name: str
    value: float
    error: float
    unit: str
    std: float | None
    status: str
    reason: str = ""
    prior_std: float | None = None
    prior_mean: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON content; without 'reason' and the prior where there is none."""
        return {key: value for key, value in vars(self).items() if value or key not in ("reason", "prior_std", "prior_mean")}


@dataclass(frozen=True)
class Rejected:
    """A measurement that was rejected as an outlier. pose: number as recorded; ball: certificate id, or None for the whole pose."""

    pose: int
    ball: int | None
    distance_mm: float


@dataclass(frozen=True, repr=False)
class CalibrationFit:
    """A converged adjustment of the cell; ``mbcacq.calibration.result.Calibration`` adds the way to JSON.

    state: the calibrated cell; preliminary: nominal arm with the hand-eye fitted alone. names: (g,) free parameters; covariance: (g, g) of
    them (hand-eye as local twist mm, rad). station_covariance: (S, 6, 6) of the stations' local twists, zero where unused.
    used: which poses (P,) of ``observations`` and centres took part. residual: (M, R) mm (and rad), measured minus predicted; whitened:
    (M, R) of unit variance. rank: of the free parameters and stations together. correlated: pairs that the data can hardly separate.
    effects: what the arm does beyond its geometry, free or held; None where the cell is geometry alone.
    """

    observations: Observations
    options: CalibrationOptions
    layout: ParameterLayout
    state: CellState
    preliminary: CellState
    coefficients: tuple[np.ndarray, ...]
    covariance: np.ndarray
    station_covariance: np.ndarray
    noise: Noise
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
    extra: dict = field(default_factory=dict)
    effects: EffectModel | None = None

    @classmethod
    def of(
        cls,
        obs: Observations,
        options: CalibrationOptions,
        lineariser: Lineariser,
        solution: Solution,
        noise: Noise,
        weights: Weights,
        preliminary: CellState,
        found: Sequence[Undetermined],
    ) -> Self:
        """Collect a converged solution."""
        normal, rows, layout = solution.normal, lineariser.rows, lineariser.layout
        scale = layout.gather("scale")
        C = scale[:, None] * positive_inverse(scale[:, None] * normal.information * scale) * scale
        station_covariance = np.zeros((len(obs.cell.stations), 6, 6))
        station_covariance[rows.stations] = normal.station_covariance(C)
        used = (weights.centre > 0) & (weights.pose[obs.pose] > 0)
        rank = layout.size + int(normal.station_rank.sum())
        dof = int(used.sum()) * rows.width + solution.prior.rows - rank
        return cls(
            observations=obs,
            options=options,
            layout=layout,
            state=solution.estimate.state,
            preliminary=preliminary,
            coefficients=solution.estimate.coefficients,
            covariance=C,
            station_covariance=station_covariance,
            noise=noise,
            weights=weights,
            residual=solution.linear.residual,
            whitened=solution.whitened_residual,
            chi2=solution.cost,
            dof=dof,
            rank=rank,
            iterations=solution.iterations,
            undetermined=tuple(found),
            rejected=_rejected(obs, solution, weights),
            correlated=_correlated(layout.names, C),
        )

    @classmethod
    def adjusted(cls, obs: Observations, options: CalibrationOptions, a: Adjustment) -> Self:
        """The fit of an adjustment of the observations under the same options."""
        return cls.of(
            obs=obs,
            options=options,
            lineariser=a.lineariser,
            solution=a.solution,
            noise=a.noise,
            weights=a.weights,
            preliminary=a.preliminary,
            found=a.found,
        )

    @property
    def cell(self) -> Cell:
        return self.observations.cell

    @property
    def names(self) -> tuple[str, ...]:
        return self.layout.names

    @property
    def used(self) -> np.ndarray:
        """(M,) bool: centres that took part."""
        return (self.weights.centre > 0) & (self.weights.pose[self.observations.pose] > 0)

    @property
    def robot(self) -> str:
        """Name of the arm."""
        return self.cell.robot.name

    @property
    def station_places(self) -> dict[str, np.ndarray]:
        """T_base_station (4, 4) by id, of the stations that took part; ``state`` has a first guess, or nothing, for the others."""
        used = np.unique(self.observations.station[self.observations.pose[self.used]])
        return {self.cell.stations[s].id: self.state.T_base_station[s] for s in used}

    @property
    def used_poses(self) -> int:
        """Number of poses of which a centre took part."""
        return len(np.unique(self.observations.pose[self.used]))

    def took_part(self, observations: Observations) -> bool:
        """Whether any pose of ``observations`` took part in this calibration: the same number with the same joint angles."""
        mine = {int(n): q for n, q in zip(self.observations.pose_id, self.observations.q, strict=True)}
        return any(int(n) in mine and np.array_equal(mine[int(n)], q) for n, q in zip(observations.pose_id, observations.q, strict=True))

    @property
    def held(self) -> dict[str, str]:
        """Held parameters with the reason."""
        return self.layout.held

    @property
    def rms_mm(self) -> float:
        """3D rms of the residuals of all centres used."""
        return float(np.sqrt(np.mean(np.sum(self.residual[self.used, :3] ** 2, axis=1)))) if self.used.any() else float("nan")

    @property
    def errors(self) -> np.ndarray:
        """(n, 5) identified MD-H errors."""
        return self.state.chain.rows - self.cell.robot.chain.rows

    @property
    def parameters(self) -> list[Parameter]:
        """Every parameter, blocks in order; of the balls only the free ones."""
        change = se3.inverse(self.cell.T_flange_scanner) @ self.state.T_flange_scanner
        turn = se3.rotation_log(change[:3, :3])
        moved = self.state.T_flange_scanner[:3, 3] - self.cell.T_flange_scanner[:3, 3]
        mount = np.concatenate([self.state.T_flange_scanner[:3, 3], turn])
        values = [self.state.chain.rows.reshape(-1), mount, self.state.balls.reshape(-1), *self.coefficients]
        shift = (self.state.balls - self.cell.ball_centres).reshape(-1)
        errors = [self.errors.reshape(-1), np.concatenate([moved, turn]), shift, *self.coefficients]
        std = iter(self._std())
        out = []
        for block, value, error in zip(self.layout.blocks, values, errors, strict=True):
            for i, name in enumerate(block.names):
                free = bool(block.free[i])
                if not free and name not in block.why:
                    continue
                status = _status(block, i, self.options.kinematics)
                prior = {}
                if status == "prior":
                    prior = {"prior_std": float(block.sigma[i]), "prior_mean": 0.0 if block.centre is None else float(block.centre[i])}
                own_std, why = next(std) if free else None, block.why.get(name, "")
                out.append(Parameter(name, float(value[i]), float(error[i]), block.units[i], own_std, status, why, **prior))
        return out

    def _std(self) -> list[float]:
        """Standard deviations of the free parameters; the hand-eye translation along the flange's axes."""
        C = self.covariance.copy()
        hand_eye = [self.names.index(f"hand_eye.{c}") for c in "xyz" if f"hand_eye.{c}" in self.names]
        if len(hand_eye) == 3:
            R = self.state.T_flange_scanner[:3, :3]
            block = np.ix_(hand_eye, hand_eye)
            C[block] = R @ C[block] @ R.T
        return np.sqrt(np.diag(C)).tolist()


def _status(block: ParameterBlock, i: int, identified: bool) -> str:
    if not block.free[i]:
        return "held"
    if block.name == "chain" and block.group is not None and not identified:
        return "marginal"
    return "prior" if np.isfinite(block.sigma[i]) else "free"


def positive_inverse(H: np.ndarray) -> np.ndarray:
    """Inverse (g, g) of a symmetric matrix that is positive but for rounding: a variance never comes out negative, as it may from a plain
    inverse where the largest and the smallest information are 16 digits apart. Such directions get the variance of the rounding."""
    value, vector = np.linalg.eigh(H)
    return (vector / np.maximum(value, 1e-15 * len(H) * value[-1])) @ vector.T if len(H) else H


def _rejected(obs: Observations, solution: Solution, weights: Weights) -> tuple[Rejected, ...]:
    size = np.linalg.norm(solution.linear.residual[:, :3], axis=1)
    out = [Rejected(int(obs.pose_id[p]), None, float(size[obs.pose == p].max(initial=0.0))) for p in np.flatnonzero(weights.pose == 0)]
    single = np.flatnonzero((weights.centre == 0) & (weights.pose[obs.pose] > 0))
    return (*out, *(Rejected(int(obs.pose_id[obs.pose[m]]), obs.cell.ball_ids[obs.ball[m]], float(size[m])) for m in single))


def _correlated(names: Sequence[str], C: np.ndarray) -> tuple[tuple[str, str, float], ...]:
    std = np.sqrt(np.diag(C))
    correlation = C / np.outer(std, std)
    i, j = np.nonzero(np.triu(np.abs(correlation) > CORRELATED, 1))
    order = np.argsort(-np.abs(correlation[i, j]))
    pairs = [(int(i[k]), int(j[k])) for k in order]
    pairs = [(a, b) for a, b in pairs if not names[a].startswith("unknown:") and not names[b].startswith("unknown:")]
    return tuple((names[a], names[b], float(correlation[a, b])) for a, b in pairs)
