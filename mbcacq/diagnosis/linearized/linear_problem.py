"""The cell linearised at its fitted geometry: residual, the columns of everything that geometry can absorb, and of any effect.

Priors (certificates, given station poses, wide bounds on the geometry) are sigmas of the nuisance parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from mbcacq.diagnosis.linearized.whitening import NoiseEstimate, Whitener, joint_columns
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState, Displacements, Prediction
from mbcacq.estimation.terms import PER_POSE, Part
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

Computed = TypeVar("Computed")


@dataclass(frozen=True)
class ColumnLayout:
    """Which nuisance column is what: slices into the free parameters."""

    geometry: slice
    mount: slice
    stations: slice
    balls: slice
    size: int


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """The recording linearised at a state of the cell.

    keep: (M,) bool of the centres that take part. residual: (M, R), R = 3, or 6 with a measured orientation. joint: (M, R, n) change of the
    prediction by each joint's angle. shared: what depends on the linearisation alone, computed once for all its restrictions.
    """

    obs: Observations
    state: CellState
    keep: np.ndarray
    prediction: Prediction
    residual: np.ndarray
    joint: np.ndarray
    shared: dict[Hashable, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, obs: Observations, state: CellState, keep: np.ndarray | None = None, displacements: Displacements | None = None
    ) -> LinearProblem:
        """Linearised at the state, moved by the displacements; without keep all centres take part."""
        prediction = forward_model.predict(obs, state, displacements)
        # The prior of the arm's parameters stays at the nominal arm, so that directions the data do not see cannot drift: the
        # linear problem is for the whole deviation from nominal, and what the state holds of it already is added back.
        deviation = (state.chain.rows - obs.cell.robot.chain.rows).reshape(-1)
        residual = forward_model.residual(obs, prediction) + geometry_columns(obs, state, prediction) @ deviation
        keep = np.ones(obs.n_centres, bool) if keep is None else keep
        return cls(obs, state, keep, prediction, residual, joint_columns(obs, prediction))

    @property
    def width(self) -> int:
        """Rows R of one centre."""
        return self.residual.shape[1]

    def __reduce__(self) -> tuple:
        return LinearProblem, (self.obs, self.state, self.keep, self.prediction, self.residual, self.joint)

    def restricted(self, keep: np.ndarray) -> LinearProblem:
        """The same linearisation with only the centres in keep (M,) bool."""
        return replace(self, keep=keep)

    def with_residual(self, residual: np.ndarray) -> LinearProblem:
        """The same linearisation of another residual (M, R)."""
        return replace(self, residual=residual)

    def computed_once(self, key: Hashable, compute: Callable[[], Computed]) -> Computed:
        """What ``compute`` returns at its first call for this key. It must depend on the linearisation alone, not on keep or residual."""
        if key not in self.shared:
            self.shared[key] = compute()
        return self.shared[key]

    # Columns ------------------------------------------------------------------------------------------------------

    def unit(self, location: str, index: int, component: int) -> np.ndarray:
        """(M, R): change of the prediction by a unit of one component of one location."""
        key = (location, index, component)
        return self.computed_once(key, lambda: self._unit(*key))

    def _unit(self, location: str, index: int, component: int) -> np.ndarray:
        obs, prediction = self.obs, self.prediction
        if location == "joint":
            return self.joint[:, :, index]
        if location == "frame":
            twist = se3.adjoint(prediction.frames[:, index])[:, :, component]
            return np.einsum("mrc,mc->mr", prediction.gradient, twist[obs.pose])
        if location == "station":
            twist = se3.adjoint(prediction.T_base_station)[:, :, component]
            return -np.einsum("mrc,mc->mr", prediction.gradient, twist[obs.pose])
        out = np.zeros((obs.n_centres, self.width))
        if location == "ball":
            out[:, :3] = forward_model.ball_jacobian(obs, prediction)[:, :, component]
        elif location == "point":
            out[:, component] = 1.0
        else:
            raise ValueError(f"no such location: {location}")
        return out

    def columns(self, parts: list[Part]) -> np.ndarray:
        """(M, R, k): columns of an effect."""
        total = np.zeros(())
        for part in parts:
            basis = part.basis[self.obs.pose] if part.place in PER_POSE else part.basis
            total = total + self.unit(part.place, part.index, part.component)[:, :, None] * basis[:, None, :]
        return total

    # Nuisance -----------------------------------------------------------------------------------------------------

    def nuisance(self) -> tuple[np.ndarray, np.ndarray, ColumnLayout]:
        """Columns (M, R, z) of the free geometry, prior sigma (z,), and which column is what."""
        obs, prediction, n = self.obs, self.prediction, self.obs.cell.robot.n
        blocks = [geometry_columns(obs, self.state, prediction)]
        sigma = [np.tile(OPTIONS.geometry_prior, n)]
        mount = forward_model.mount_jacobian(obs, prediction)
        components = 6 if obs.cell.measurement != TARGET_IN_BASE or obs.sees_target_turn else 3
        blocks.append(mount[:, :, :components])
        sigma.append(np.array(OPTIONS.mount_prior[:components]))
        used_stations = np.unique(obs.station)
        local = forward_model.station_jacobian(obs, prediction)
        station = np.zeros((obs.n_centres, self.width, 6 * len(used_stations)))
        for j, s in enumerate(used_stations):
            rows = obs.station[obs.pose] == s
            station[rows, :, 6 * j : 6 * j + 6] = local[rows]
            given = obs.cell.stations[s].sigma_mm if obs.cell.stations[s].T_base_station is not None else None
            sigma.append(np.array(OPTIONS.station_prior) if given is None else np.array([given] * 3 + [given / 100.0] * 3))
        blocks.append(station)
        z = 5 * n + components
        if len(obs.cell.ball_ids) > 1:
            balls = forward_model.ball_jacobian(obs, prediction)
            used = np.unique(obs.ball)
            ball = np.zeros((obs.n_centres, self.width, 3 * len(used)))
            uncertainty = np.array([a.uncertainty_mm for a in obs.cell.artefacts])[obs.cell.ball_artefact]
            for j, b in enumerate(used):
                rows = obs.ball == b
                ball[rows, :3, 3 * j : 3 * j + 3] = balls[rows]
                sigma.append(np.full(3, max(uncertainty[b], 1e-5)))
            blocks.append(ball)
        stations = slice(z, z + 6 * len(used_stations))
        sigma = np.concatenate(sigma)
        return (
            np.concatenate(blocks, axis=2),
            sigma,
            ColumnLayout(slice(0, 5 * n), slice(5 * n, z), stations, slice(stations.stop, len(sigma)), len(sigma)),
        )

    def moved(self, step: np.ndarray, layout: ColumnLayout) -> CellState:
        """The state of a solution (z,) of the nuisance parameters: the arm's as deviation from nominal, mount and stations as a step.

        What has a certificate stays at its certified value; the linear problem moves it.
        """
        n = self.obs.cell.robot.n
        mount = np.zeros(6)
        free = step[layout.mount]
        mount[: len(free)] = free
        T = self.state.T_base_station.copy()
        for j, s in enumerate(np.unique(self.obs.station)):
            if self.obs.cell.stations[s].T_base_station is not None and self.obs.cell.stations[s].sigma_mm is not None:
                continue
            T[s] = T[s] @ se3.exp(step[layout.stations][6 * j : 6 * j + 6])
        return replace(
            self.state,
            chain=self.obs.cell.robot.chain.with_errors(step[layout.geometry].reshape(n, 5)),
            T_flange_scanner=self.state.T_flange_scanner @ se3.exp(mount),
            T_base_station=T,
        )

    def whitener(self, noise: NoiseEstimate) -> Whitener:
        return Whitener(self.obs, self.joint, noise, self.keep)


def geometry_columns(obs: Observations, state: CellState, prediction: Prediction) -> np.ndarray:
    """(M, R, 5 n): change of the prediction by the MD-H parameters, link by link."""
    n = obs.cell.robot.n
    twists = state.chain.parameter_twists(prediction.frames, obs.q).reshape(obs.n_poses, 5 * n, 6)
    return forward_model.arm_jacobian(obs, prediction, twists)
