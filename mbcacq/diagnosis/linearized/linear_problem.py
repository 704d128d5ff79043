"""The cell linearised at its fitted geometry: whitened residual, the columns of everything that geometry can absorb, and of any effect.

Priors (certificates, given station poses, wide bounds on the geometry) are extra rows below the measured ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbcacq.diagnosis.linearized.whitening import NoiseEstimate, Whitener, joint_columns
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState, Displacements
from mbcacq.estimation.terms import PER_POSE, Part
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

GEOMETRY_PRIOR = np.array([0.02, 3.0, 3.0, 0.02, 0.02])  # theta rad, d mm, a mm, alpha rad, beta rad: wider than any real arm
MOUNT_PRIOR = np.array([500.0, 500.0, 500.0, 2.0, 2.0, 2.0])
STATION_PRIOR = np.array([1e4, 1e4, 1e4, 3.0, 3.0, 3.0])


@dataclass(frozen=True)
class ColumnLayout:
    """Which nuisance column is what: slices into the free parameters."""

    geometry: slice
    mount: slice
    stations: slice
    balls: slice
    size: int


class LinearProblem:
    """obs, state and keep as given; prediction, residual (M, R), and columns of free geometry (rows, nuisance)."""

    def __init__(self, obs: Observations, state: CellState, keep: np.ndarray | None = None, displacements: Displacements | None = None):
        self.obs, self.state, self.displacements = obs, state, displacements
        self.keep = np.ones(obs.n_centres, bool) if keep is None else keep
        self.prediction = forward_model.predict(obs, state, displacements)
        self.residual = forward_model.residual(obs, self.prediction)
        self.width = self.residual.shape[1]
        # The prior of the arm's parameters stays at the nominal arm, so that directions the data do not see cannot drift: the
        # linear problem is for the whole deviation from nominal, and what the state holds of it already is added back.
        deviation = (state.chain.rows - obs.cell.robot.chain.rows).reshape(-1)
        self.residual = self.residual + self._geometry_columns() @ deviation
        self.joint = joint_columns(obs, self.prediction)
        self._unit: dict[tuple[str, int, int], np.ndarray] = {}
        self.kept: dict[int, Any] = {}  # what others make of this linearisation once and use again

    # Columns ------------------------------------------------------------------------------------------------------

    def unit(self, place: str, index: int, component: int) -> np.ndarray:
        """(M, R): change of the prediction by a unit of one component of one place."""
        key = (place, index, component)
        if key not in self._unit:
            self._unit[key] = self._make_unit(*key)
        return self._unit[key]

    def _make_unit(self, place: str, index: int, component: int) -> np.ndarray:
        obs, prediction = self.obs, self.prediction
        if place == "joint":
            return self.joint[:, :, index]
        if place == "frame":
            twist = se3.adjoint(prediction.frames[:, index])[:, :, component]
            return np.einsum("mrc,mc->mr", prediction.gradient, twist[obs.pose])
        if place == "station":
            twist = se3.adjoint(prediction.T_base_station)[:, :, component]
            return -np.einsum("mrc,mc->mr", prediction.gradient, twist[obs.pose])
        out = np.zeros((obs.n_centres, self.width))
        if place == "ball":
            out[:, :3] = forward_model.ball_jacobian(obs, prediction)[:, :, component]
        elif place == "point":
            out[:, component] = 1.0
        else:
            raise ValueError(f"no such place: {place}")
        return out

    def columns(self, parts: list[Part]) -> np.ndarray:
        """(M, R, k) of an effect."""
        total = 0.0
        for part in parts:
            basis = part.basis[self.obs.pose] if part.place in PER_POSE else part.basis
            total = total + self.unit(part.place, part.index, part.component)[:, :, None] * basis[:, None, :]
        return total

    # Nuisance -----------------------------------------------------------------------------------------------------

    def _geometry_columns(self) -> np.ndarray:
        """(M, R, 5 n): by the MD-H parameters, link by link."""
        obs, n = self.obs, self.obs.cell.robot.n
        twists = self.state.chain.parameter_twists(self.prediction.frames, obs.q).reshape(obs.n_poses, 5 * n, 6)
        return forward_model.arm_jacobian(obs, self.prediction, twists)

    def nuisance(self) -> tuple[np.ndarray, np.ndarray, ColumnLayout]:
        """Columns (M, R, z) of the free geometry, prior sigma (z,), and what is where."""
        obs, prediction, n = self.obs, self.prediction, self.obs.cell.robot.n
        blocks = [self._geometry_columns()]
        sigma = [np.tile(GEOMETRY_PRIOR, n)]
        mount = forward_model.mount_jacobian(obs, prediction)
        components = 6 if obs.cell.measurement != TARGET_IN_BASE or obs.shows_target_orientation else 3
        blocks.append(mount[:, :, :components])
        sigma.append(MOUNT_PRIOR[:components])
        seen = np.unique(obs.station)
        local = forward_model.station_jacobian(obs, prediction)
        station = np.zeros((obs.n_centres, self.width, 6 * len(seen)))
        for j, s in enumerate(seen):
            rows = obs.station[obs.pose] == s
            station[rows, :, 6 * j : 6 * j + 6] = local[rows]
            given = obs.cell.stations[s].sigma_mm if obs.cell.stations[s].T_base_station is not None else None
            sigma.append(STATION_PRIOR if given is None else np.array([given] * 3 + [given / 100.0] * 3))
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
        stations = slice(z, z + 6 * len(seen))
        sigma = np.concatenate(sigma)
        return (
            np.concatenate(blocks, axis=2),
            sigma,
            ColumnLayout(slice(0, 5 * n), slice(5 * n, z), stations, slice(stations.stop, len(sigma)), len(sigma)),
        )

    def moved(self, step: np.ndarray, layout: ColumnLayout) -> CellState:
        """The state of a solution (z,) of the nuisance parameters: the arm's as deviation from nominal, mount and stations as a step.

        What has a certificate stays at it, the linear problem moves it.
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

    def restricted(self, keep: np.ndarray) -> LinearProblem:
        """The same linearisation with only the centres in keep (M,) bool; columns are shared."""
        out = object.__new__(LinearProblem)
        out.__dict__.update(self.__dict__)
        out.keep = keep
        return out

    def whitener(self, noise: NoiseEstimate) -> Whitener:
        return Whitener(self.obs, self.joint, noise, self.keep)
