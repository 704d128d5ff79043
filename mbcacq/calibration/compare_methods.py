"""Methods of calibration on the same data, judged alike: fit, sphere spacing error, held-out error, time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal, overload

import numpy as np

from mbcacq.calibration import notebook
from mbcacq.calibration.calibrated_cell import CalibratedCell, verify
from mbcacq.calibration.held_out_poses import HeldOutRms, about_best_station, predicted, rms
from mbcacq.calibration.methods import COMPARED_METHODS, OF_LINKS
from mbcacq.errors import CalibrationError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.model.json_text import AsJson
from mbcacq.model.observations import Observations
from mbcacq.quantities import fixed

FOLDS = 5
SAME_POSTURE = np.radians(0.1)


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One method.

    Attributes
    ----------
    fit_mm : float or None
        3D rms about the best station poses, on the poses fitted.
    bar_mean_mm, bar_max_mm : float or None
        Sphere spacing error at the verification poses.
    held_out_mm : float or None
        3D rms on held-out stations (or, with one or two stations, poses).
    why : str
        Why there is no result.
    why_not_held_out : str
        Why there is no held-out figure, where one was asked for.
    """

    method: str
    fit_mm: float | None = None
    bar_mean_mm: float | None = None
    bar_max_mm: float | None = None
    held_out_mm: float | None = None
    time_s: float | None = None
    why: str = ""
    why_not_held_out: str = ""


@dataclass(frozen=True, repr=False)
class Comparison(AsJson, Sequence[ComparisonRow]):
    """The rows of a comparison, in the order of the methods; a sequence of them.

    Attributes
    ----------
    rows
        One row for each method.
    """

    format: Literal["mbcacq-comparison/1"] = field(default="mbcacq-comparison/1", kw_only=True)
    rows: tuple[ComparisonRow, ...]

    @overload
    def __getitem__(self, index: int) -> ComparisonRow: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[ComparisonRow, ...]: ...

    def __getitem__(self, index: int | slice) -> ComparisonRow | tuple[ComparisonRow, ...]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        judged = [row for row in self.rows if row.held_out_mm is not None]
        best = min(judged, key=lambda row: row.held_out_mm or 0.0) if judged else None
        smallest = f", smallest held-out error {best.held_out_mm:.4f} mm by {best.method}" if best else ""
        return f"Comparison({len(self.rows)} methods{smallest})"

    def _repr_html_(self) -> str:
        rows = [
            (r.method, *(fixed(v, 4) for v in (r.fit_mm, r.bar_mean_mm, r.bar_max_mm, r.held_out_mm)), fixed(r.time_s, 2))
            for r in self.rows
        ]
        header = ("method", "fit rms mm", "bar mean mm", "bar max mm", "held-out rms mm", "time s")
        return notebook.table("Methods of calibration", header, rows)


def compare(
    observations: Observations,
    methods: Iterable[str] | None = None,
    *,
    held_out: bool = True,
    seed: int = 0,
    progress: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """One row a method of ``mbcacq.calibration.methods.COMPARED_METHODS``, in that order. Those that identify links are left out where the
    data are poses of a flange; a method that these data do not determine has the reason in place of figures. progress: gets a sentence a
    method. Raises CalibrationError where no method is determined: no station was seen from two postures."""
    obs = select_phases(observations, CalibrationOptions())
    if posture_range(obs) < SAME_POSTURE:
        raise CalibrationError(
            "every station was seen from one posture of the arm only, which leaves all but the shape of the scans "
            "undetermined; nothing can be compared. Take several different poses at each station"
        )
    of_flange = obs.cell.robot.of_flange_poses  # which have no links to identify
    names = [name for name in COMPARED_METHODS if not (of_flange and name in OF_LINKS)] if methods is None else list(methods)
    rows = []
    for number, name in enumerate(names, 1):
        progress(f"{name} (method {number}/{len(names)})")  # no count: some take a hundred times as long as others
        rows.append(_row(name, COMPARED_METHODS[name], obs, observations, held_out, seed))
    return Comparison(tuple(rows))


def _row(
    name: str, fit: Callable[[Observations], CellState | CalibratedCell], obs: Observations, whole: Observations, held_out: bool, seed: int
) -> ComparisonRow:
    begin = time.perf_counter()
    try:
        cell = fit(obs)
    except CalibrationError as error:
        return ComparisonRow(method=name, why=str(error))
    seconds = time.perf_counter() - begin
    d, _ = about_best_station(obs, cell)
    bar = verify(whole, cell)
    errors = np.abs(bar.errors("after")) if bar.places else None
    held_out_mm, why = None, ""
    try:
        held_out_mm = _held_out(fit, obs, seed) if held_out else None
    except CalibrationError as error:
        why = str(error)
    return ComparisonRow(
        method=name,
        fit_mm=rms(d),
        bar_mean_mm=None if errors is None else float(errors.mean()),
        bar_max_mm=None if errors is None else float(errors.max()),
        held_out_mm=held_out_mm,
        time_s=seconds,
        why_not_held_out=why,
    )


def posture_range(obs: Observations) -> float:
    """Largest change (rad) of a joint angle between the poses of any one station."""
    return max(float(np.ptp(obs.q[obs.station == s], axis=0).max()) for s in np.unique(obs.station))


def _held_out(fit: Callable[[Observations], CellState | CalibratedCell], obs: Observations, seed: int) -> float:
    """Stations in FOLDS groups, each left out once; with fewer than three stations, random poses. Raises CalibrationError where the rest
    does not determine the method's unknowns."""
    rng = np.random.default_rng(seed)
    stations = np.unique(obs.station)
    by_station = len(stations) >= 3
    unit = obs.station if by_station else np.arange(obs.n_poses)
    distances, freedom = [], 0
    for part in np.array_split(rng.permutation(np.unique(unit)), min(FOLDS, len(np.unique(unit)))):
        test = np.isin(unit, part)
        d, used = predicted(obs.select(test), fit(obs.select(~test)), by_station)
        distances.append(d)
        freedom += used
    found = HeldOutRms.of(distances, freedom)
    if not np.isfinite(found.rms_mm):
        raise CalibrationError("the centres left out are too few to judge anything by; measure more poses")
    return found.rms_mm
