"""Recorded pose rows into the arrays a solver takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbcacq.errors import RecordingError
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.cell_yaml import parse_cell

Row = dict[str, Any]
RESTART_S = 60.0  # clocks that differ by more over a pause were restarted


def assemble(cell_yaml: str, name: str, rows: Sequence[Row]) -> Observations:
    """rows: those of ``layout.OBSERVATION`` in the order recorded; each says to which part of a resumed run it belongs."""
    cell = parse_cell(cell_yaml, f"{name} (its cell description)")
    latest: dict[int, Row] = {}
    for row in rows:
        latest.pop(int(row["pose"][0]), None)
        latest[int(row["pose"][0])] = row
    found = list(latest.values())
    shift = _clock_shifts(found, bool(cell.simulated))
    count = np.array([len(row["ball"]) for row in found])
    ball = np.concatenate([row["ball"] for row in found]).astype(np.int64)
    sensors, extra = _sensors(found)
    for i, axis in enumerate(("x", "y", "z")):
        extra[f"centres.scatter_{axis}_mm"] = _text(np.concatenate([row["scatter_mm"].reshape(-1, 3)[:, i] for row in found]))
    return Observations(
        cell=cell,
        pose_id=np.array(list(latest), dtype=np.int64),
        station=_index([station.id for station in cell.stations], [row["station"][0] for row in found], f"{name}: station"),
        q=np.stack([row["q"] for row in found]),
        pose=np.repeat(np.arange(len(found)), count),
        ball=_index(cell.ball_ids, ball.tolist(), f"{name}: ball"),
        xyz=np.concatenate([row["xyz"].reshape(-1, 3) for row in found]),
        phase=np.array([row["phase"][0] for row in found]),
        time_s=np.array([row["robot_time_s"][0] + shift[int(row["part"][0])] for row in found]),
        direction=np.stack([row["direction"] for row in found]),
        temperatures=sensors,
        n_points=_whole(np.concatenate([row["n_points"] for row in found])),
        rms_mm=np.concatenate([row["rms_mm"] for row in found]),
        extra=extra,
        cell_yaml=cell_yaml,
    )


def _clock_shifts(rows: Sequence[Row], simulated: bool) -> dict[int, float]:
    """What to add to the controller's clock, by part: nothing where it went on over the pause, else what the computer's clock says. The
    clock of a fake cell that goes on stands still in the pause.
    """
    before = rows[0]
    shifts = {int(before["part"][0]): 0.0}
    for row in rows:
        part = int(row["part"][0])
        if part not in shifts:
            robot = float(row["robot_time_s"][0] - before["robot_time_s"][0])
            host = float(row["time_s"][0] - before["time_s"][0])
            host = host if host >= 0 else max(robot, 0.0)  # a clock that was set back in the pause says nothing of it
            earlier = shifts[int(before["part"][0])]
            shifts[part] = earlier + host - robot if robot < 0 or not simulated and abs(host - robot) > RESTART_S else earlier
        before = row
    return shifts


def _sensors(found: Sequence[Row]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Temperatures that every pose has, and everything else as text columns."""
    by_pose = [dict(zip(row.get("sensors_names", ()), row.get("sensors_values", ()), strict=True)) for row in found]
    temperatures, extra = {}, {}
    for name in dict.fromkeys(name for values in by_pose for name in values):
        if name.endswith("_C") and all(name in values for values in by_pose):
            temperatures[name] = np.array([values[name] for values in by_pose], dtype=float)
        else:
            extra[f"poses.{name}"] = np.array([repr(float(values[name])) if name in values else "" for values in by_pose])
    if all("current" in row for row in found):
        current = np.stack([row["current"] for row in found])
        extra |= {f"poses.i{i + 1}_percent": _text(column) for i, column in enumerate(current.T)}
    extra["poses.step"] = np.array([row["step"][0] for row in found])
    extra["poses.n_exposures"] = _text(np.array([row["n_exposures"][0] for row in found]))
    return temperatures, extra


def _index(known: Sequence[Any], measured: Sequence[Any], called: str) -> np.ndarray:
    """The places of what was measured in what is known. called: what to call them."""
    index = {one: i for i, one in enumerate(known)}
    unknown = sorted(set(measured) - set(index))
    if unknown:
        raise RecordingError(f"{called} {unknown[0]!r} was measured but is not in the recorded cell; is the recording complete?")
    return np.array([index[one] for one in measured], dtype=np.int64)


def _whole(values: np.ndarray) -> np.ndarray:
    return values.astype(np.int64) if np.array_equal(values, np.rint(values)) else values


def _text(values: np.ndarray) -> np.ndarray:
    return np.array(list(map(repr, np.asarray(values).tolist())))
