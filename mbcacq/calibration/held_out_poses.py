"""Poses that take no part in a fit: which they are, how far off a calibrated cell predicts them, and the figures of that.

Every held-out figure counts every centre that was held out. A robust figure may stand beside it, under that name and with its own count.
"""

from __future__ import annotations

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.verification import points_in_base
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.adjustment import Known, as_it_is
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.initial_guess import with_all_stations
from mbcacq.estimation.solver import solve
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

GROSS = 10.0  # medians, beyond which a centre is gross: no model that is compared comes nearer to it


def gross(*distances: np.ndarray) -> np.ndarray:
    """(M,) bool of the centres that every compared model misses by more than GROSS medians. distances: (M,) mm by each model."""
    least = np.min(distances, axis=0)
    return least > GROSS * np.median(least)


def rms(d: np.ndarray, freedom: int = 0) -> float:
    """3D rms (mm) of distances (M,) where ``freedom`` of the 3 M coordinates were spent on a fit."""
    share = 1 - freedom / (3 * len(d)) if len(d) else 0.0
    return float(np.sqrt(np.mean(d**2) / share)) if share > 0 else float("nan")


def held_out_masks(obs: Observations, split: str, size: int | None, fits: int | None, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    if split == "station":
        stations = np.unique(obs.station)
        if len(stations) < 2:
            raise CalibrationError("there is one station only; none can be left out. Use --held-out random or block")
        return [obs.station == s for s in stations]
    if split == "random":
        size = size or min(300, max(1, int(round(0.3 * obs.n_poses))))
        if size >= obs.n_poses:
            raise ConfigError(f"{size} poses cannot be held out of {obs.n_poses}; give a smaller number")
        parts = [rng.choice(obs.n_poses, size, replace=False) for _ in range(fits or 3)]
    else:
        order = np.argsort(obs.time_s if obs.time_s is not None else obs.pose_id, kind="stable")
        parts = np.array_split(order, fits or 5)
    known = [_known_places(obs, np.isin(np.arange(obs.n_poses), part)) for part in parts]
    if not any(m.any() for m in known):
        raise CalibrationError("every pose left out shows a ball that the others do not locate; use --held-out station or random")
    return [m for m in known if m.any()]


def _known_places(obs: Observations, test: np.ndarray) -> np.ndarray:
    """The poses whose balls have a position that training determines: the same ball at the same station was measured, or three others.

    One socket of two does not determine where the other is, and nothing is known of a station without training poses.
    """
    if obs.cell.measurement == TARGET_IN_BASE:
        return test & np.isin(obs.station, np.unique(obs.station[~test]))
    trained = np.zeros((len(obs.cell.stations), len(obs.cell.ball_ids)), bool)
    train = ~test[obs.pose]
    station = obs.station[obs.pose]
    trained[station[train], obs.ball[train]] = True
    known = trained[station, obs.ball] | (trained.sum(axis=1) >= 3)[station]
    unknown = np.bincount(obs.pose, ~known, minlength=obs.n_poses) > 0
    return test & ~unknown


def predicted(held: Observations, cell: CellState | CalibratedCell, by_station: bool) -> tuple[np.ndarray, int]:
    """(M,) mm distances of held-out centres from their prediction, and the degrees of freedom that it took: the places of whole stations,
    which nothing else tells, are fitted to them."""
    return about_best_station(held, cell) if by_station else (prediction_error(held, cell), 0)


def prediction_error(obs: Observations, cell: CellState | CalibratedCell) -> np.ndarray:
    """(M,) mm distance of measured centres from where a cell, with its effects where it has any, predicts them."""
    return np.linalg.norm(as_it_is(obs, _parts(cell)[0], _known(obs, cell)).residual[:, :3], axis=1)


def about_best_station(obs: Observations, cell: CellState | CalibratedCell) -> tuple[np.ndarray, int]:
    """(M,) mm distances of centres about the best pose of their stations, everything else fixed; and the degrees of freedom that took."""
    solution = solve(as_it_is(obs, with_all_stations(obs, _parts(cell)[0]), _known(obs, cell)))
    return np.linalg.norm(solution.residual[:, :3], axis=1), int(solution.normal.station_rank.sum())


def ball_spread(obs: Observations, cell: CellState | CalibratedCell) -> np.ndarray:
    """(M,) mm distance of each ball, brought into the base, from the mean place of that ball at that station."""
    if obs.cell.measurement == TARGET_IN_BASE:
        return about_best_station(obs, cell)[0]
    base = points_in_base(obs, *_parts(cell))
    _, group = np.unique(obs.station[obs.pose] * len(obs.cell.ball_ids) + obs.ball, return_inverse=True)
    mean = np.stack([np.bincount(group, base[:, j]) for j in range(3)], axis=1) / np.bincount(group)[:, None]
    return np.linalg.norm(base - mean[group], axis=1)


def known(obs: Observations, effects: EffectModel | None) -> Known:
    """Effects with their coefficients, as terms of a recording that they displace."""
    return tuple(zip(effects.at(obs), effects.coefficients, strict=True)) if effects else ()


def _known(obs: Observations, cell: CellState | CalibratedCell) -> Known:
    """The effects of a cell, and what it found of the errors of the instrument in its recording, and so in these."""
    if isinstance(cell, CellState):
        return ()
    return (*known(obs, cell.effects), *(cell.own_fit.instrument_errors(obs) if cell.own_fit else ()))


def _parts(cell: CellState | CalibratedCell) -> tuple[CellState, EffectModel | None]:
    return (cell, None) if isinstance(cell, CellState) else (cell.state, cell.effects)
