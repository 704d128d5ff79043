"""Gauss-Newton with Levenberg-Marquardt damping, on the manifold of the cell's transforms; noise and weights are fixed, station poses
eliminated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.estimation.linearization import Lineariser, Linearization
from mbcacq.estimation.normal_equations import Normal, Prior, WhitenedSystem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.estimation.whitening import Whitening
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell

SMALLEST_SHARE = 1e-4


@dataclass(frozen=True)
class Weights:
    """Weight of each centre (M,) and each pose (P,): 1 full, 0 rejected."""

    centre: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class Solution:
    """An estimate and the whitened system at it. X: (P, B R, g + 7) whitened; cost: chi square with the prior rows."""

    estimate: Estimate
    linear: Linearization
    whitening: Whitening
    X: np.ndarray
    normal: Normal
    prior: Prior
    noise: Noise
    weights: Weights
    iterations: int

    @property
    def cost(self) -> float:
        return self.normal.cost

    @property
    def system(self) -> WhitenedSystem:
        return WhitenedSystem(self.whitening, self.X, self.normal)


def system(lineariser: Lineariser, estimate: Estimate, noise: Noise, weights: Weights, iterations: int = 0) -> Solution:
    """The whitened normal equations at an estimate."""
    linear = lineariser(estimate)
    whitening = Whitening(lineariser.rows, linear.J, noise, weights.centre, weights.pose)
    X = whitening(linear.X)
    prior = prior_rows(lineariser.obs.cell, lineariser.layout, estimate, lineariser.rows.stations)
    return Solution(estimate, linear, whitening, X, Normal(lineariser.rows, X, prior), prior, noise, weights, iterations)


def reweighted(lineariser: Lineariser, at: Solution, noise: Noise, weights: Weights) -> Solution:
    """The system at the same estimate with other noise or weights."""
    if noise is at.noise and weights is at.weights:
        return at
    whitening = Whitening(lineariser.rows, at.linear.J, noise, weights.centre, weights.pose)
    X = whitening(at.linear.X)
    return replace(at, whitening=whitening, X=X, normal=Normal(lineariser.rows, X, at.prior), noise=noise, weights=weights)


def solve(
    lineariser: Lineariser, start: Estimate | Solution, noise: Noise, weights: Weights, *, tolerance: float = 1e-6, limit: int = 30
) -> Solution:
    """Iterate until the next step would take less than ``tolerance`` off the cost (chi square).

    A ``Solution`` of the same lineariser as start saves evaluating it anew.
    """
    layout = lineariser.layout
    damping, share = 0.0, 1.0
    now = reweighted(lineariser, start, noise, weights) if isinstance(start, Solution) else system(lineariser, start, noise, weights)
    for iteration in range(1, limit + 1):
        step = gauss_newton_step(now.normal, layout.gather("scale"), damping)
        promised = now.normal.decrease(step)
        if promised < tolerance or share < SMALLEST_SHARE:
            break
        station_step = np.zeros((len(now.estimate.state.T_base_station), 6))
        station_step[lineariser.rows.stations] = now.normal.station_step(step)
        candidate = now.estimate.moved(layout, share * step, share * station_step)
        trial = system(lineariser, candidate, noise, weights, iteration)
        # The weights depend weakly on the estimate; a step is judged by those it was computed with.
        cost = float(np.sum(now.whitening(trial.linear.X[..., -1:]) ** 2)) + trial.prior.cost
        if cost <= now.cost * (1 + 1e-9) + tolerance:
            now, damping, share = trial, damping / 10 if damping > 1e-3 else 0.0, 1.0
        else:
            # Damping holds back the parameters only; the share holds back the stations as well.
            damping, share = max(10 * damping, 1e-2), share / 4
    return now


def gauss_newton_step(normal: Normal, scale: np.ndarray, damping: float) -> np.ndarray:
    """Step (g,) of the reduced normal equations: Gauss-Newton without ``damping``, Levenberg-Marquardt with it (relative to each
    parameter's own information)."""
    H = scale[:, None] * normal.information * scale
    diagonal = np.diag(H).copy()
    H[np.diag_indices_from(H)] += damping * diagonal + 1e-14 * diagonal.max(initial=0.0)
    return scale * np.linalg.solve(H, scale * normal.gradient)


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
    return Prior(layout.gather("sigma"), offset, information, twist)


def known_placement(cell: Cell, s: int, given: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information (6, 6) and offset (6,) of station ``s`` at T (4, 4), which was ``given`` (4, 4) with sigma_mm for each of its balls
    (0.05 mm if not said)."""
    station = cell.stations[s]
    sigma = station.sigma_mm or 0.05
    points = cell.artefact(station.artefact).centres
    columns = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -se3.skew(points)], axis=2)
    off = se3.inverse(given) @ T
    information = np.einsum("mri,mrj->ij", columns, columns) / sigma**2 / max(len(points) / 3, 1)
    return information, np.concatenate([off[:3, 3], se3.rotation_log(off[:3, :3])])
