"""What the recorder draws for display: the path done and to come, the scan coloured on its balls, the quality of each ball."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from mbcacq.acquisition import events
from mbcacq.devices import Scan
from mbcacq.geometry import se3
from mbcacq.model.cell import Artefact, Cell
from mbcacq.quantities import in_degrees
from mbcacq.recording.rrd import layout, scan_colouring, scene
from mbcacq.recording.rrd.drawable import drawable, drawn_text
from mbcacq.recording.rrd.drawn_later import DrawnLater
from mbcacq.recording.rrd.stand import StationStand
from mbcacq.spheres.found import SphereOptions

DONE, NOW, TO_COME = (0, 158, 115, 170), (240, 228, 66, 255), (140, 148, 158, 40)
LIMITS = SphereOptions()
SEGMENT_POINTS = 8  # of a segment straight in joint space


class Drawing:
    """Draws the events that matter for display; the owner of the stream sets the times on it. artefact: at the station, or None."""

    def __init__(self, stream: DrawnLater) -> None:
        self._rec = stream
        self._cell: Cell | None = None
        self._stand: StationStand | None = None
        self._route: list[int] = []
        self.artefact: Artefact | None = None
        self._scan: Scan | None = None
        self._form: list[np.ndarray] = []
        self._drawn_temperatures: set[str] = set()
        self._balls: dict[str, dict[int, np.ndarray]] = {}

    def start(self, cell: Cell, event: events.RunStarted) -> None:
        self._cell, self._route = cell, list(event.route)
        self._stand = StationStand.of(event.plan_yaml)
        scene.log_obstacles(self._rec, event.plan_yaml)
        scene.log_ball_series(self._rec, cell)
        scene.log_limits(self._rec)
        self._rec.log(layout.SUMMARY, drawn_text("No calibration yet: `mbcacq run` makes one at its end."), static=True)
        self._rec.log(layout.DIAGNOSIS_TEXT, drawn_text("No diagnosis yet: `mbcacq diagnose RUN` makes one."), static=True)
        if event.route:
            strips = flange_strips(cell, scene.home(event.plan_yaml, cell.robot.n), event.route)
            self._rec.log(layout.PATH, rr.LineStrips3D(strips, radii=rr.Radius.ui_points(0.6)), static=True)
            self._rec.log(layout.PATH, rr.LineStrips3D.from_fields(colors=[TO_COME] * len(strips)))

    def station(self, event: events.StationReached) -> None:
        """The artefact's new place is the bright one, those before fade."""
        if self._cell is None:
            return
        self.artefact = self._cell.artefact(event.artefact)
        if self._stand is not None:
            self._stand.log(self._rec, event.station)
        for other in self._balls:
            scene.fade_balls(self._rec, other, bright=other == event.station)

    def reached(self, event: events.PoseReached) -> None:
        self._form = []
        self._rec.log(layout.JOINTS, rr.Scalars(in_degrees(event.q) if self._cell is None else self._cell.robot.drawn(event.q)))
        if self._cell is not None:
            station = next((s for s in self._cell.stations if s.id == event.station), None)
            self.artefact = None if station is None else self._cell.artefact(station.artefact)
        if event.pose in self._route:
            at = self._route.index(event.pose)
            colours = [DONE] * at + [NOW] + [TO_COME] * (len(self._route) - at - 1)
            self._rec.log(layout.PATH, rr.LineStrips3D.from_fields(colors=colours))

    def taken(self, event: events.ScanTaken) -> None:
        self._scan = event.scan

    def found(self, event: events.CentresFound) -> None:
        """The scan as soon as its balls are known."""
        if self._cell is None or self._scan is None or self.artefact is None:
            return
        coloured = scan_colouring.colour_scan(self._scan.points, self.artefact, event.ball, event.xyz)
        self._scan = None
        self._form.append(_by_ball(self._cell, event.ball, np.stack([coloured.form_um, coloured.radius_um], axis=1)))
        if event.exposure:
            return  # the first exposure of a pose is drawn
        on_balls = rr.Points3D(coloured.on_balls.astype(np.float32), colors=coloured.colours, radii=rr.Radius.ui_points(1.6))
        self._rec.log(layout.ON_BALLS, on_balls)
        background = rr.Points3D(coloured.background.astype(np.float32), colors=[scan_colouring.GREY], radii=rr.Radius.ui_points(0.8))
        self._rec.log(layout.BACKGROUND, background)

    def done(self, event: events.PoseDone) -> None:
        if self._cell is None:
            return
        self._rec.log(f"{layout.LIMITS}/zero", rr.Scalars(0.0))
        self._rec.log(f"{layout.LIMITS}/points", rr.Scalars(float(LIMITS.min_points)))
        self._rec.log(f"{layout.LIMITS}/rms", rr.Scalars(1e3 * LIMITS.max_noise))
        values = _by_ball(self._cell, event.ball, np.stack([event.n_points, 1e3 * np.asarray(event.rms_mm)], axis=1))
        for entity, column in zip((layout.BALL_POINTS, layout.BALL_RMS), values.T, strict=True):
            self._rec.log(entity, rr.Scalars(column))
        if self._form:
            form = np.array(self._form)
            count = np.maximum(np.isfinite(form).sum(axis=0), 1)
            mean = np.where(np.isfinite(form).any(axis=0), np.nansum(form, axis=0) / count, np.nan)
            for entity, column in zip((layout.BALL_FORM, layout.BALL_SIZE), mean.T, strict=True):
                self._rec.log(entity, rr.Scalars(column))
        self.temperatures(event.sensors)
        if event.current is not None:
            self._rec.log(layout.CURRENT, rr.Scalars(np.asarray(event.current, dtype=float)))
        if len(event.ball):
            self._show_balls(self._cell, event)

    def _show_balls(self, cell: Cell, event: events.PoseDone) -> None:
        """Where the balls of a station stand as measured so far, nominal arm."""
        T = cell.robot.chain.flange(event.q[None])[0] @ cell.T_flange_scanner
        artefact = next(s.artefact for s in cell.stations if s.id == event.station)
        balls = self._balls.setdefault(event.station, {})
        balls.update(zip(np.asarray(event.ball).tolist(), se3.apply(T, np.asarray(event.xyz)), strict=True))
        scene.log_balls(self._rec, event.station, cell.artefact(artefact), balls)

    def temperatures(self, values: Mapping[str, float], device: str = "") -> None:
        """Log the temperatures among some values, which are known by the ending of their names. device: that stated them."""
        for name, value in values.items():
            if not name.endswith("_C"):
                continue
            entity = f"{layout.TEMPERATURE}/{rr.escape_entity_path_part(name)}"
            if name not in self._drawn_temperatures:
                colour = scene.CURVES[len(self._drawn_temperatures) % len(scene.CURVES)]
                self._drawn_temperatures.add(name)
                title = f"{device} {name.removesuffix('_C').replace('_', ' ')}".strip()  # the unit stands above the curves
                self._rec.log(entity, rr.SeriesLines(names=[drawable(title)], colors=[colour], widths=[1.5]), static=True)
            self._rec.log(entity, rr.Scalars(float(value)))


def _by_ball(cell: Cell, ball: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(k, c) of some balls -> (balls of the cell, c), NaN where there is none."""
    ids = list(cell.ball_ids)
    out = np.full((len(ids), values.shape[1]), np.nan)
    out[[ids.index(b) for b in np.asarray(ball).tolist()]] = values
    return out


def flange_strips(cell: Cell, home: np.ndarray, route: Mapping[int, np.ndarray]) -> list[np.ndarray]:
    """Path of the flange (k, 3) mm to each pose of a route, nominal arm; its segments are straight in joint space."""
    strips, q = [], home
    share = np.linspace(0.0, 1.0, SEGMENT_POINTS)[:, None]
    for corners in route.values():
        ends = np.atleast_2d(corners)
        starts = np.vstack([q[None], ends[:-1]])
        joints = np.concatenate([a + share * (b - a) for a, b in zip(starts, ends, strict=True)])
        strips.append(cell.robot.chain.flange(joints)[:, :3, 3].astype(np.float32))
        q = ends[-1]
    return strips
