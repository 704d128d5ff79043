"""Raw controller cycles into the recording: every row at once as received; curves in deg and the drawn arm in larger, rarer batches."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mbcacq.cell import Cell
from mbcacq.devices import Cycles
from mbcacq.recording import layout, rows, scene

DRAW_PERIOD_S = 0.04       # of the drawn arm, on the controller's clock
SHOW_PERIOD_S = 0.5        # between two batches for the eye: each batch costs a chunk per entity
OTHER_CLOCK_S = 10.0


class CycleWriter:
    """Writes batches of cycles to a stream. ``show`` sends what was kept back for the eye."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._rec = stream
        self._drawn = self._shown = -np.inf
        self._kept: list[dict[str, np.ndarray]] = []

    def write(self, cycles: Cycles, time_s: float, clock: float, offset: float, cell: Cell | None) -> None:
        """time_s: of the event; clock: this computer's monotonic clock when the run started; offset: added to all run times (s)."""
        columns = {name: np.asarray(values) for name, values in cycles.columns.items()}
        host = columns["host_time_s"] - clock
        if abs(host[-1] - time_s) > OTHER_CLOCK_S:       # another clock than this computer's: only its spacing is to be trusted
            host = columns["host_time_s"] - columns["host_time_s"][-1] + time_s
        host = host + offset
        self._rec.send_columns(layout.CYCLES, _index(host, columns["time_s"]), rows.columns(layout.CYCLES_ARCHETYPE, columns))
        self._kept.append({"host": host, "robot": columns["time_s"], **_curves(columns), "q": columns["q"]})
        if time_s - self._shown >= SHOW_PERIOD_S:
            self._shown = time_s
            self.show(cell)

    def show(self, cell: Cell | None) -> None:
        """Curves and drawn arm of everything written since the last call."""
        if not self._kept:
            return
        shared = set.intersection(*(set(batch) for batch in self._kept))
        batch = {name: np.concatenate([b[name] for b in self._kept]) for name in shared}
        self._kept.clear()
        host, robot, q = batch.pop("host"), batch.pop("robot"), batch.pop("q")
        for entity, values in batch.items():
            scalars = rr.Scalars.columns(scalars=values.reshape(-1)).partition(np.full(len(values), values.shape[1]))
            self._rec.send_columns(entity, _index(host, robot), scalars)
        keep = self._to_draw(robot)
        if cell is not None and keep:
            for entity, T in scene.arm_frames(cell, q[keep]).items():
                self._rec.send_columns(entity, _index(host[keep], robot[keep]), rr.Transform3D.columns(**scene.transforms(T)))

    def _to_draw(self, robot: np.ndarray) -> list[int]:
        keep = []
        for k, t in enumerate(robot.tolist()):
            if t - self._drawn >= DRAW_PERIOD_S or t < self._drawn:
                keep.append(k)
                self._drawn = t
        return keep


def _index(host: np.ndarray, robot: np.ndarray) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(layout.TIME, duration=host), rr.TimeColumn(layout.ROBOT_TIME, duration=robot)]


def _curves(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    curves = {layout.JOINTS: np.degrees(columns["q"])}
    if "q_set" in columns:
        curves[layout.FOLLOWING] = np.degrees(columns["q_set"]) - curves[layout.JOINTS]
    if "current_percent" in columns:
        curves[layout.CURRENT] = np.asarray(columns["current_percent"], dtype=float)
    return curves
