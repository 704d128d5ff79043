"""What is known beforehand, as rows beside the measured ones: certificates, priors of the arm and of terms, given placements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.parameters import Estimate, ParameterLayout
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell


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
    off = se3.inverse(given) @ T
    information = np.einsum("mri,mrj->ij", columns, columns) / sigma**2 / max(len(points) / 3, 1)
    return information, np.concatenate([off[:3, 3], se3.rotation_log(off[:3, :3])])
