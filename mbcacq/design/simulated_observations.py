"""What a plan would record: the nominal cell seen at its planned poses, as observations, and trial recordings of random true cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import first_noise
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, Transit

# Errors (1 sigma) of a usual arm against its data sheet: theta rad, d mm, a mm, alpha rad, beta rad. Hand-eye and stations: mm, rad.
USUAL_ERRORS = np.array([5e-4, 0.15, 0.15, 2e-4, 1.5e-4])
USUAL_MOUNT = np.array([1.0, 1.0, 1.0, 5e-3, 5e-3, 5e-3])
STANDSTILL = 1e-4


def planned_state(loaded: LoadedPlan) -> CellState:
    """The cell exactly as planned."""
    cell = loaded.cell
    return CellState(cell.robot.chain, cell.T_flange_scanner, np.stack([s.T_base_station for s in cell.stations]), cell.ball_centres)


def planned_noise(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Noise:
    """Of one recorded centre: the plan's scanner noise, averaged over the exposures of a pose; the joints' repeatability from the arm's
    data sheet, which exposures do not average."""
    noise = first_noise(loaded.cell)
    return replace(noise, point=noise.point / np.sqrt(min((p.exposures for p in poses), default=1)))


def planned_observations(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit] | None = None, starts: Sequence[float] | None = None
) -> Observations:
    """Every planned pose with its expected balls where the nominal cell shows them.

    Stations are unknown to a solver, so their planned places are left out of the cell. transits: for the sense of each axis' last
    motion; starts: (P,) s, for effects of time.
    """
    cell = replace(loaded.cell, stations=tuple(replace(s, T_base_station=None, sigma_mm=None) for s in loaded.cell.stations))
    station = {s.id: i for i, s in enumerate(cell.stations)}
    ball = {b: i for i, b in enumerate(cell.ball_ids)}
    seen = [(k, ball[b]) for k, p in enumerate(poses) for b in p.balls]
    pose, balls = np.array(seen, dtype=int).reshape(-1, 2).T
    blank = Observations(
        cell=cell,
        pose_id=np.array([p.number for p in poses]),
        station=np.array([station[p.station] for p in poses]),
        q=np.array([p.q for p in poses]),
        pose=pose,
        ball=balls,
        xyz=np.zeros((len(pose), 3)),
        phase=np.array([p.phase for p in poses]),
        time_s=None if starts is None else np.array(starts, dtype=float),
        direction=None if transits is None else _directions(loaded, poses, transits),
    )
    return replace(blank, xyz=forward_model.predict(blank, planned_state(loaded)).xyz)


def trial(loaded: LoadedPlan, observations: Observations, noise: Noise, rng: np.random.Generator) -> Observations:
    """What a random true cell with usual errors would record at the same poses: scanner noise and joint repeatability drawn anew."""
    state, n = planned_state(loaded), loaded.cell.robot.n
    truth = CellState(
        state.chain.with_errors(USUAL_ERRORS * rng.standard_normal((n, 5))),
        state.T_flange_scanner @ se3.exp(USUAL_MOUNT * rng.standard_normal(6)),
        state.T_base_station @ se3.exp(USUAL_MOUNT * rng.standard_normal((len(state.T_base_station), 6))),
        state.balls,
    )
    stood = replace(observations, q=observations.q + noise.joint * rng.standard_normal(observations.q.shape))
    xyz = forward_model.predict(stood, truth).xyz
    return replace(observations, xyz=xyz + noise.point * rng.standard_normal(xyz.shape))


def _directions(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit]) -> np.ndarray:
    """(P, n) -1, 0, 1: how each axis last moved before it came to rest."""
    last = np.radians(loaded.plan.robot.home_deg)
    sense, out = np.zeros(len(last), dtype=int), []
    for pose, transit in zip(poses, transits, strict=True):
        for stop in [*transit, pose.q]:
            moved = stop - last
            sense = np.where(np.abs(moved) > STANDSTILL, np.sign(moved), sense).astype(int)
            last = stop
        out.append(sense)
    return np.array(out)
