"""What a plan would record: observations of the nominal cell at its planned poses, and simulated recordings of random true cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.design.options import OPTIONS
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import first_noise
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, Transit


def planned_state(loaded: LoadedPlan) -> CellState:
    """The cell exactly as planned."""
    cell = loaded.cell
    return CellState(cell.robot.chain, cell.T_flange_scanner, np.stack([s.planned_pose for s in cell.stations]), cell.ball_centres)


def planned_noise(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Noise:
    """Noise of one recorded centre: the plan's scanner noise, averaged over the exposures of a pose, and the joints' repeatability from
    the arm's data sheet, which exposures do not average."""
    noise = first_noise(loaded.cell)
    return replace(noise, point=noise.point / np.sqrt(min((p.exposures for p in poses), default=1)))


def planned_observations(
    loaded: LoadedPlan,
    poses: Sequence[PlannedPose],
    transits: Sequence[Transit] | None = None,
    starts: Sequence[float] | np.ndarray | None = None,
) -> Observations:
    """Every planned pose with its expected balls where the nominal cell shows them.

    Stations are unknown to a solver, so their planned places are left out of the cell. transits: for each axis' last direction
    of rotation; starts: (P,) s, for effects of time.
    """
    cell = replace(loaded.cell, stations=tuple(replace(s, T_base_station=None, sigma_mm=None) for s in loaded.cell.stations))
    station, pose, balls = expected_centres(cell, poses)
    numbers, q, phase = (np.array(x) for x in ([p.number for p in poses], [p.q for p in poses], [p.phase for p in poses]))
    time_s = None if starts is None else np.array(starts, dtype=float)
    direction = None if transits is None else np.array(last_directions(loaded, poses, transits))
    nowhere = np.zeros((len(pose), 3))
    blank = Observations(cell, numbers, station, q, pose, balls, nowhere, phase=phase, time_s=time_s, direction=direction)
    return replace(blank, xyz=forward_model.predict(blank, planned_state(loaded)).xyz)


def expected_centres(cell: Cell, poses: Sequence[PlannedPose]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(P,) index of the station of each pose; (M,) of the pose and (M,) of the ball of each centre that it is to show."""
    station = {s.id: i for i, s in enumerate(cell.stations)}
    ball = {b: i for i, b in enumerate(cell.ball_ids)}
    expected = [(k, ball[b]) for k, p in enumerate(poses) for b in p.balls]
    pose, balls = np.array(expected, dtype=int).reshape(-1, 2).T
    return np.array([station[p.station] for p in poses], dtype=int), pose, balls


def simulated_recording(loaded: LoadedPlan, observations: Observations, noise: Noise, rng: np.random.Generator) -> Observations:
    """What a random true cell with usual errors would record at the same poses: scanner noise and joint repeatability drawn anew."""
    state, n = planned_state(loaded), loaded.cell.robot.n
    errors, mounting = np.array(OPTIONS.parameter_errors), np.array(OPTIONS.mounting_errors)
    chain, mount = state.chain.with_errors(errors * rng.standard_normal((n, 5))), se3.exp(mounting * rng.standard_normal(6))
    places = state.T_base_station @ se3.exp(mounting * rng.standard_normal((len(state.T_base_station), 6)))
    truth = CellState(chain, state.T_flange_scanner @ mount, places, state.balls)
    stood = replace(observations, q=observations.q + noise.joint * rng.standard_normal(observations.q.shape))
    xyz = forward_model.predict(stood, truth).xyz
    return replace(observations, xyz=xyz + noise.point * rng.standard_normal(xyz.shape))


def last_directions(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit]) -> list[np.ndarray]:
    """(n,) -1, 0, 1 of each pose: the direction in which each axis last moved before it came to rest."""
    last = loaded.plan.robot.home
    direction, out = np.zeros(len(last), dtype=int), []
    for pose, transit in zip(poses, transits, strict=True):
        for stop in [*transit, pose.q]:
            moved = stop - last
            direction = np.where(np.abs(moved) > OPTIONS.standstill, np.sign(moved), direction).astype(int)
            last = stop
        out.append(direction)
    return out
