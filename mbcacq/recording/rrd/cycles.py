"""Raw controller cycles into the recording: every batch at once, packed; curves in deg and the drawn arm in larger, rarer batches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr

from mbcacq.devices import Cycles
from mbcacq.model.cell import Cell
from mbcacq.quantities import in_degrees
from mbcacq.recording.rrd import layout, rows, scene
from mbcacq.recording.rrd.packed_cycles import packed
from mbcacq.recording.rrd.urdf_arm import UrdfArm

DRAW_PERIOD_S = 0.04  # of the drawn arm, on the controller's clock
DRAW_RAD = 5e-5  # an arm whose axes turned by less is not drawn anew: 0.1 mm at a reach of 2 m
CURVE_EVERY = 5  # cycles to a point of a curve; the extremes of what is left out are kept where they matter
LIVE_PERIOD_S, SHOW_PERIOD_S = 0.5, 60.0  # at most between two batches for display, watched or not: each is a chunk of 2 kB per entity
OTHER_CLOCK_S = 10.0


class CycleWriter:
    """Writes batches of cycles to a stream. ``show`` sends what was kept back for display."""

    def __init__(self, stream: rr.RecordingStream, *, live: bool = False) -> None:
        self._rec = stream
        self._period_s = LIVE_PERIOD_S if live else SHOW_PERIOD_S
        self._drawn = self._shown = -np.inf
        self._drawn_q: np.ndarray | None = None
        self.urdf: UrdfArm | None = None  # draws the arm as well, where there is one
        self._start: float | None = None  # POSIX time of the start of this part, where it is known
        self._last = np.full((1, 2), np.nan)  # controller's and this computer's time of the cycle before
        self._kept: list[dict[str, np.ndarray]] = []

    def started(self, posix_s: float) -> None:
        """The date and time (s since 1970) at which run time 0 was."""
        self._start = posix_s

    def write(self, cycles: Cycles, time_s: float, clock: float, offset: float, cell: Cell | None) -> None:
        """time_s: of the event; clock: this computer's monotonic clock when the run started; offset: added to all run times (s)."""
        columns = {name: np.asarray(values) for name, values in cycles.columns.items()}
        host = columns["host_time_s"] - clock
        if abs(host[-1] - time_s) > OTHER_CLOCK_S:  # another clock than this computer's: only its spacing is to be trusted
            host = columns["host_time_s"] - columns["host_time_s"][-1] + time_s
        host = host + offset
        whole = rows.columns(layout.CYCLES_ARCHETYPE, {layout.PACKED: packed(columns)[None]})
        self._rec.send_columns(layout.CYCLES, [rr.TimeColumn(layout.TIME, duration=host[-1:])], whole)
        curves = _curves(columns, in_degrees if cell is None else cell.robot.drawn)
        self._kept.append({"host": host, "robot": columns["time_s"], **curves, "q": columns["q"]})
        if time_s - self._shown >= self._period_s:
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
        batch[layout.PERIOD] = self._periods(robot, host)
        first = np.arange(0, len(robot), CURVE_EVERY)
        for entity, values in batch.items():
            if entity in EXTREMES:
                values, at = _extremes(values, first), first
            else:
                values, at = values[first], first
            scalars = rr.Scalars.columns(scalars=values.reshape(-1)).partition(np.full(len(values), values.shape[1]))
            self._rec.send_columns(entity, self._index(host[at], robot[at]), scalars)
        keep = self._to_draw(robot, q)
        if cell is not None and keep:
            frames, index = scene.arm_frames(cell, q[keep]), self._index(host[keep], robot[keep])
            moves = scene.transforms(np.concatenate(list(frames.values())))
            for k, entity in enumerate(frames):
                own = slice(k * len(keep), (k + 1) * len(keep))
                columns = rr.Transform3D.columns(translation=moves["translation"][own], quaternion=moves["quaternion"][own])
                self._rec.send_columns(entity, index, columns)
            if self.urdf is not None:
                self.urdf.pose(self._rec, q[keep], index)

    def _periods(self, robot: np.ndarray, host: np.ndarray) -> np.ndarray:
        """(k, 2) ms from the cycle before, by the controller's clock and by this computer's; NaN for the first of all."""
        now = np.stack([robot, host], axis=1)
        before, self._last = self._last, now[-1:]
        return 1e3 * np.diff(now, axis=0, prepend=before)

    def _index(self, host: np.ndarray, robot: np.ndarray) -> list[rr.TimeColumn]:
        index = [rr.TimeColumn(layout.TIME, duration=host), rr.TimeColumn(layout.ROBOT_TIME, duration=robot)]
        if self._start is not None:
            index.append(rr.TimeColumn(layout.CLOCK, timestamp=self._start + host))
        return index

    def _to_draw(self, robot: np.ndarray, q: np.ndarray) -> list[int]:
        keep = []
        for k, t in enumerate(robot.tolist()):
            moved = self._drawn_q is None or np.abs(q[k] - self._drawn_q).max() > DRAW_RAD
            if moved and (t - self._drawn >= DRAW_PERIOD_S or t < self._drawn):
                keep.append(k)
                self._drawn, self._drawn_q = t, q[k]
        return keep


EXTREMES = (layout.FOLLOWING, layout.PERIOD, layout.DELAY)


def _extremes(values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(k, n) -> (len(first), n): the value farthest from zero in each group of rows, so that no spike is lost."""
    high, low = np.maximum.reduceat(values, first, axis=0), np.minimum.reduceat(values, first, axis=0)
    return np.where(high >= -low, high, low)


def _curves(columns: dict[str, np.ndarray], drawn: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    curves = {layout.JOINTS: drawn(columns["q"])}
    asked = columns.get("q_command", columns.get("q_set"))  # a controller's own set point may lack the corrections it was sent
    if asked is not None:
        curves[layout.SET] = drawn(asked)
        curves[layout.FOLLOWING] = curves[layout.SET] - curves[layout.JOINTS]
    if "current_percent" in columns:
        curves[layout.CURRENT] = np.asarray(columns["current_percent"], dtype=float)
    if "delay" in columns:
        curves[layout.DELAY] = np.asarray(columns["delay"], dtype=float)[:, None]
    return curves
