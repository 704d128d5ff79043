"""The rows of a check at chosen poses of a plan, linearised at the calibrated cell, and the choice of these poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_io import state_from_dict
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.design.simulated_observations import planned_observations
from mbcacq.errors import ConfigError
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState, Prediction
from mbcacq.interim_check.e_process import Rows, weight_of
from mbcacq.interim_check.options import OPTIONS, CheckOptions, UsualChanges
from mbcacq.interim_check.possible_changes import (
    PossibleChange,
    jitter,
    joint_columns,
    possible_changes,
    rows_of,
    station_columns,
    twist_columns,
)
from mbcacq.model.cell import ARTEFACT_IN_SCANNER
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, path


@dataclass(frozen=True)
class PlannedCheck:
    """Poses of a plan as a check.

    Attributes
    ----------
    poses : tuple[PlannedPose, ...]
        In the order of the plan.
    state : CellState
        The calibrated cell with the stations as planned.
    obs : Observations
        The recording of the nominal cell: M centres, R = 3 M rows.
    prediction : Prediction
        Prediction by the calibrated cell with its effects.
    rows, changes
        Rows and changes of the e-process.
    standing : bool
        Artefacts stay where they stand between checks; otherwise each is placed anew, and its place is not judged.
    shown : ndarray
        (R,) bool, rows that count.
    """

    poses: tuple[PlannedPose, ...]
    cell: CalibratedCell
    state: CellState
    obs: Observations
    prediction: Prediction
    rows: Rows
    changes: tuple[PossibleChange, ...]
    standing: bool
    shown: np.ndarray

    @property
    def keys(self) -> list[tuple[int, int]]:
        """(number of the pose, certificate's id of the ball) of each of the M centres."""
        return [(int(self.obs.pose_id[p]), self.obs.cell.ball_ids[b]) for p, b in zip(self.obs.pose, self.obs.ball, strict=True)]


def planned_check(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], cell: CalibratedCell, standing: bool, days: UsualChanges
) -> PlannedCheck:
    """A check by these poses. Raises ConfigError if the result is of another arm, or the plan's instrument does not ride on the arm."""
    refuse_other_arm("the result is of", cell.robot, cell.nominal, loaded.cell.robot, "the plan")
    if loaded.cell.measurement != ARTEFACT_IN_SCANNER:
        raise ConfigError(f"{loaded.path}: a check needs a scanner on the arm; this plan measures a target from outside")
    state = calibrated_state(loaded, cell)
    obs = planned_observations(loaded, poses, path(loaded, list(poses)))
    displaced = None if not cell.effects else cell.effects.displacements(obs)
    prediction = forward_model.predict(obs, state, displaced)
    stations = [rows_of(part) for part in station_columns(obs, prediction).values()]
    free = np.zeros((3 * obs.n_centres, 0)) if standing else np.concatenate(stations, axis=1)
    noise = jitter(obs, state, prediction, cell.noise.point, cell.noise.joint)
    rows = Rows(noise, _daily(obs, state, prediction, stations, standing, days), free)
    found, every = tuple(possible_changes(obs, state, prediction, standing)), np.ones(3 * obs.n_centres, dtype=bool)
    return PlannedCheck(tuple(poses), cell, state, obs, prediction, rows, found, standing=standing, shown=every)


def calibrated_state(loaded: LoadedPlan, cell: CalibratedCell) -> CellState:
    """The calibrated arm and hand-eye, the plan's stations where it means them to be, and its balls: calibrated ones where the result has
    them, certified ones otherwise."""
    certified = loaded.cell.ball_centres
    filled = state_from_dict(cell.to_dict(), loaded.cell, other="the plan")
    known = np.array([b in cell.ball_ids for b in loaded.cell.ball_ids])
    balls = np.where(known[:, None], filled.balls, certified)
    return replace(filled, balls=balls, T_base_station=np.stack([s.planned_pose for s in loaded.cell.stations]))


def _daily(
    obs: Observations, state: CellState, prediction: Prediction, stations: list[np.ndarray], standing: bool, days: UsualChanges
) -> np.ndarray:
    """(R, d): what one standard deviation of each change from day to day does."""
    joints = joint_columns(state, prediction) * days.joint
    mount = twist_columns(obs, prediction, "frame", obs.cell.robot.n) * np.repeat([days.mount_mm, days.mount_rad], 3)
    placed = [part * np.repeat([days.station_mm, days.station_rad], 3) for part in stations] if standing else []
    return np.concatenate([rows_of(joints), rows_of(mount), *placed], axis=1)


def choose_poses(check: PlannedCheck, options: CheckOptions = OPTIONS) -> list[int]:
    """Numbers of the poses that notice most of what may have changed: of one station, nested by backward elimination.

    The criterion is the sum over all changes of log(1 + information of their usual change), as ``optimality_criteria`` has it for a design;
    each pose's part is computed once. The artefact moves not at all within a check. Raises ConfigError if no station has enough poses.
    """
    best: tuple[float, list[int]] | None = None
    for s in np.unique(check.obs.station):
        here = [int(p) for p in np.flatnonzero(check.obs.station == s) if (check.obs.pose == p).sum() >= 3]
        if len(here) < options.fewest:
            continue
        grams, first, free = _pose_grams(check, here)
        kept = list(range(len(here)))
        while len(kept) > options.poses:
            total = grams[kept].sum(axis=0)
            criteria = [_criterion(total - grams[k], first, free) for k in kept]
            kept.pop(int(np.argmax(criteria)))
        value = _criterion(grams[kept].sum(axis=0), first, free)
        if best is None or value > best[0]:
            best = value, [int(check.obs.pose_id[here[k]]) for k in kept]
    if best is None:
        raise ConfigError(
            f"no station of this plan has {options.fewest} poses that show three balls or more, as a check needs; add views at one station"
        )
    return best[1]


def _pose_grams(check: PlannedCheck, poses: Sequence[int]) -> tuple[np.ndarray, np.ndarray, int]:
    """Information of each pose (P, K, K) about all columns but the unnamed ones, first about the f that are free; where those of
    each change begin; and f."""
    named = [r.columns for r in check.changes if r.name != "unnamed"]
    free = check.rows.free
    columns = np.concatenate([free, *named], axis=1)
    first = free.shape[1] + np.cumsum([0, *(c.shape[1] for c in named)])
    grams = []
    for p in poses:
        rows = np.repeat(check.obs.pose == p, 3)
        weight, _ = weight_of(check.rows.noise[np.ix_(rows, rows)], np.zeros((int(rows.sum()), 0)))
        grams.append(columns[rows].T @ weight @ columns[rows])
    return np.array(grams), first, free.shape[1]


def _criterion(gram: np.ndarray, first: np.ndarray, free: int) -> float:
    """Sum over the changes of the log determinants of one plus their information, what is free absorbed."""
    if free:
        own = gram[:free, :free] + 1e-9 * np.trace(gram[:free, :free]) / free * np.eye(free)
        gram = gram - gram[:, :free] @ np.linalg.solve(own, gram[:free])
    total = 0.0
    for a, b in zip(first[:-1], first[1:], strict=True):
        block = np.eye(b - a) + gram[a:b, a:b]
        total += float(np.log(block[0, 0])) if b - a == 1 else float(np.linalg.slogdet(block)[1])
    return total
