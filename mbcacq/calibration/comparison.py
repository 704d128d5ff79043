"""Rivals on the same data, judged the same way: fit, sphere spacing error, held-out error, time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass

import numpy as np

from mbcacq.calibration.estimate import select_phases
from mbcacq.calibration.forward import CellState
from mbcacq.calibration.held_out import about_best_station, prediction_error
from mbcacq.calibration.options import Options
from mbcacq.calibration.rivals import RIVALS
from mbcacq.calibration.verification import verify
from mbcacq.errors import CalibrationError
from mbcacq.observations import Observations

FOLDS = 5


@dataclass(frozen=True)
class Row:
    """One method. fit_mm: 3D rms about the best station poses, on the poses fitted; bar_mean_mm, bar_max_mm: sphere spacing error at the
    verification poses; held_out_mm: 3D rms on stations (or, with one station, poses) left out; why: why there is no result."""

    method: str
    fit_mm: float | None = None
    bar_mean_mm: float | None = None
    bar_max_mm: float | None = None
    held_out_mm: float | None = None
    time_s: float | None = None
    why: str = ""

    def to_dict(self) -> dict:
        return asdict(self)


def compare(observations: Observations, methods: Iterable[str] | None = None, *, held_out: bool = True, seed: int = 0) -> list[Row]:
    """One row a method of :data:`mbcacq.calibration.rivals.RIVALS`, in that order."""
    obs = select_phases(observations, Options())
    names = list(RIVALS) if methods is None else list(methods)
    return [_row(name, RIVALS[name], obs, observations, held_out, seed) for name in names]


def _row(name: str, fit: Callable[[Observations], CellState], obs: Observations, whole: Observations, held_out: bool, seed: int) -> Row:
    begin = time.perf_counter()
    try:
        state = fit(obs)
    except CalibrationError as error:
        return Row(name, why=str(error))
    seconds = time.perf_counter() - begin
    d, _ = about_best_station(obs, state)
    bar = verify(whole, state)
    errors = np.abs(bar.errors("after")) if bar.places else None
    left = _held_out(fit, obs, seed) if held_out else None
    return Row(name, _rms(d), *((None, None) if errors is None else (float(errors.mean()), float(errors.max()))), left, seconds)


def _held_out(fit: Callable[[Observations], CellState], obs: Observations, seed: int) -> float | None:
    """Stations in FOLDS groups, each left out once; with fewer than three stations, random poses."""
    rng = np.random.default_rng(seed)
    stations = np.unique(obs.station)
    by_station = len(stations) >= 3
    unit = obs.station if by_station else np.arange(obs.n_poses)
    square, freedom, count = 0.0, 0, 0
    for part in np.array_split(rng.permutation(np.unique(unit)), min(FOLDS, len(np.unique(unit)))):
        test = np.isin(unit, part)
        try:
            state = fit(obs.select(~test))
        except CalibrationError:
            return None
        d, used = about_best_station(obs.select(test), state) if by_station else (prediction_error(obs.select(test), state), 0)
        square, freedom, count = square + float(np.sum(d**2)), freedom + used, count + len(d)
    return float(np.sqrt(square / count / (1 - freedom / (3 * count)))) if 3 * count > freedom else None


def _rms(d: np.ndarray) -> float:
    return float(np.sqrt(np.mean(d**2)))
