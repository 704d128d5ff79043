"""Normal equations with the station poses eliminated (Schur complement): time and memory are linear in poses and stations.

What is known beforehand (certificates, priors of the arm and of terms, given placements) is further rows, beside the measured ones.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dtrtri  # pyright: ignore[reportAttributeAccessIssue] -- compiled, without stubs

from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.pose_information import PoseInformation
from mbcacq.estimation.whitening import PoseRows
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell

# Share of a station's largest information below which a direction is unobservable: balls on one line but for a lever 3000 times smaller.
UNOBSERVABLE = 1e-7
STATION_SCALE = np.array([1.0, 1.0, 1.0, 1e-2, 1e-2, 1e-2])


class Normal:
    """Whitened system of g parameters and 6 per station, reduced to g.

    information: (g, g) of the parameters with the stations' freedom taken out; gradient: (g,). Directions of a station
    that its data do not determine (two balls leave the rotation about their line) are excluded by a pseudo-inverse; station_rank: (S',).
    """

    def __init__(
        self,
        rows: PoseRows,
        products: tuple[np.ndarray, np.ndarray, np.ndarray],
        right_hand_side: tuple[np.ndarray, np.ndarray, float],
        prior: Prior,
    ):
        """products: H (g, g) of the columns, and of each station Hss (S', 6, 6), Hsg (S', 6, g); right_hand_side: b (g,), bs (S', 6) with
        the residual, and its chi square. Both without the prior."""
        H, Hss, Hsg = products
        self.rows, self.size = rows, len(H)
        Hss = Hss + prior.station_information
        scaled = STATION_SCALE[:, None] * Hss * STATION_SCALE
        value, vector = np.linalg.eigh(scaled)
        observable = value > UNOBSERVABLE * np.maximum(value[:, -1:], 1e-300)
        self.station_rank = observable.sum(axis=1)
        value = np.where(observable, value, 1.0)
        self.station_log_det = float(np.sum(np.log(value)))  # up to a constant
        self.station_root = STATION_SCALE[:, None] * vector * (observable / np.sqrt(value))[:, None, :]  # F F' = pseudo-inverse of Hss
        self.reduced = np.swapaxes(self.station_root, 1, 2) @ Hsg  # F' Hsg
        tall = self._tall
        self.information = H + np.diag(1.0 / prior.sigma**2) - tall.T @ tall
        self._set_right_hand_side(*right_hand_side, prior)

    @property
    def _tall(self) -> np.ndarray:
        return self.reduced.reshape(6 * len(self.reduced), self.size)

    def _set_right_hand_side(self, b: np.ndarray, bs: np.ndarray, chi2: float, prior: Prior) -> None:
        bs = bs - np.einsum("sij,sj->si", prior.station_information, prior.station_offset)
        self.cost = chi2 + prior.cost
        self.station_b = np.einsum("sji,sj->si", self.station_root, bs)
        self.gradient = b - prior.offset / prior.sigma**2 - self._tall.T @ self.station_b.reshape(-1)

    def with_right_hand_side(self, b: np.ndarray, bs: np.ndarray, chi2: float, prior: Prior) -> Normal:
        """The same columns and another residual, of products b (g,) and bs (S', 6) with the columns, at another offset from the prior."""
        out = copy(self)
        out._set_right_hand_side(b, bs, chi2, prior)
        return out

    def with_prior(self, prior: Prior, before: Prior) -> Normal:
        """The same with another prior of the parameters; that of the stations stays."""
        out = copy(self)
        out.information = self.information + np.diag(prior.sigma**-2.0 - before.sigma**-2.0)
        out.gradient = self.gradient + before.offset / before.sigma**2 - prior.offset / prior.sigma**2
        out.cost = self.cost - before.cost + prior.cost
        return out

    def after(self, step: np.ndarray) -> Normal:
        """The same linear problem after a step (g,) of the parameters and the best stations."""
        out = copy(self)
        out.cost = self.cost - self.decrease(step)
        out.gradient = self.gradient - self.information @ step
        out.station_b = np.zeros_like(self.station_b)
        return out

    def with_weight(self, weight: np.ndarray) -> Normal:
        """The same with further prior information (g,) of the parameters."""
        out = copy(self)
        out.information = self.information + np.diag(weight)
        return out

    def gauss_newton_step(self, scale: np.ndarray, damping: float = 0.0) -> np.ndarray:
        """(g,) of the parameters: Gauss-Newton without ``damping``, Levenberg-Marquardt with it (relative to each parameter's own
        information). scale: (g,) plausible sizes."""
        H = scale[:, None] * self.information * scale
        diagonal, on = np.diag(H).copy(), np.arange(len(H))
        H[on, on] += damping * diagonal + 1e-14 * diagonal.max(initial=0.0)
        return scale * np.linalg.solve(H, scale * self.gradient)

    def decrease(self, step: np.ndarray) -> float:
        """Decrease of the cost that the linear system predicts for this step and the best stations."""
        return float(2 * step @ self.gradient - step @ self.information @ step + np.sum(self.station_b**2))

    def station_step(self, step: np.ndarray) -> np.ndarray:
        """(S', 6) best local twists of the stations after a step (g,) of the parameters."""
        return np.einsum("sij,sj->si", self.station_root, self.station_b - self.reduced @ step)

    def reduce(self, A: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows (P, m, g) and (P, m, 6) of any linear form, as (P, m, g) and (P, m, 6) so that its variance is
        x C x' + y y', with C the covariance of the parameters."""
        y = S @ self.station_root[self.rows.run]
        return A - y @ self.reduced[self.rows.run], y

    def station_covariance(self, C: np.ndarray) -> np.ndarray:
        """(S', 6, 6) covariance of the stations' local twists, C (g, g) being that of the parameters."""
        back = self.station_root @ self.reduced
        own = self.station_root @ np.swapaxes(self.station_root, 1, 2)
        return own + back @ C @ np.swapaxes(back, 1, 2)


@dataclass(frozen=True)
class PoseSystem:
    """A whitened problem by the twists of its poses."""

    poses: PoseInformation
    normal: Normal

    def with_weight(self, weight: np.ndarray) -> PoseSystem:
        """The same with further prior information (g,) of the parameters."""
        return replace(self, normal=self.normal.with_weight(weight))

    def after_fit(self) -> PoseSystem:
        """The same with the residual that the best fit of the parameters and stations leaves."""
        columns, normal = self.poses.columns, self.normal
        H = normal.information
        step = np.linalg.solve(H + 1e-14 * np.diag(H).max(initial=1.0) * np.eye(normal.size), normal.gradient)
        residual = self.poses.residual_after(step, normal.station_step(step))
        return replace(self, poses=self.poses.with_residual(replace(columns, residual=residual)), normal=normal.after(step))


def inverse_of_lower(factor: np.ndarray) -> np.ndarray:
    """Inverse of a lower triangular matrix (k, k)."""
    return dtrtri(factor, lower=1)[0] if len(factor) else factor


@dataclass(frozen=True)
class Prior:
    """Zero-mean rows in addition to the measured ones. sigma: (g,), inf = none; offset: (g,) present value minus the prior's centre.
    station_information: (S', 6, 6) and station_offset: (S', 6), of placements that were given with an uncertainty."""

    sigma: np.ndarray
    offset: np.ndarray
    station_information: np.ndarray
    station_offset: np.ndarray

    @property
    def cost(self) -> float:
        x = self.offset / self.sigma
        return float(x @ x + np.einsum("si,sij,sj->", self.station_offset, self.station_information, self.station_offset))

    @property
    def rows(self) -> int:
        return int(np.isfinite(self.sigma).sum()) + int(sum(np.linalg.matrix_rank(i) for i in self.station_information if i.any()))


def prior_rows(cell: Cell, layout: ParameterLayout, estimate: Estimate, stations: np.ndarray) -> Prior:
    """Certificates, priors of the arm and of terms, and the placements that were given, at an estimate."""
    balls = (estimate.state.balls - cell.ball_centres).reshape(-1)
    arm = (estimate.state.chain.rows - cell.robot.chain.rows).reshape(-1)
    if (centre := layout.blocks[0].centre) is not None:
        arm = arm - centre
    offsets = [arm, np.zeros(len(layout.blocks[1].names)), balls, *estimate.coefficients]
    offset = np.concatenate([o[b.free] for o, b in zip(offsets, layout.blocks, strict=True)])
    information = np.zeros((len(stations), 6, 6))
    twist = np.zeros((len(stations), 6))
    for j, s in enumerate(stations):
        station = cell.stations[s]
        if station.T_base_station is not None:
            information[j], twist[j] = known_placement(cell, s, station.T_base_station, estimate.state.T_base_station[s])
    return Prior(layout.sigma, offset, information, twist)


def known_placement(cell: Cell, s: int, given: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information (6, 6) and offset (6,) of station ``s`` at T (4, 4), which was ``given`` (4, 4) with sigma_mm for each of its balls
    (0.05 mm if not said)."""
    station = cell.stations[s]
    sigma = station.sigma_mm or 0.05
    points = cell.artefact(station.artefact).centres
    columns = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -se3.skew(points)], axis=2)
    information = np.einsum("mri,mrj->ij", columns, columns) / sigma**2 / max(len(points) / 3, 1)
    return information, se3.coordinates(se3.inverse(given) @ T)
