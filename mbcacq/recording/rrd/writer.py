"""The recorder: an event subscriber that writes everything that happens into one .rrd file, and to a live viewer on request."""

from __future__ import annotations

import shutil
import threading
import time
import uuid
from dataclasses import replace
from datetime import datetime
from functools import singledispatchmethod
from pathlib import Path

import numpy as np
import rerun as rr

from mbcacq.acquisition import events
from mbcacq.errors import Aborted, ConfigError, MbcacqError, RecordingError
from mbcacq.model.cell import SIMULATED, Cell
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.rrd import layout, rows, scene
from mbcacq.recording.rrd.blueprint import Enlarged, blueprint, for_cell
from mbcacq.recording.rrd.choice_panel import WeighedPoses, log_choice
from mbcacq.recording.rrd.cycles import CycleWriter
from mbcacq.recording.rrd.drawable import drawable
from mbcacq.recording.rrd.drawing import Drawing
from mbcacq.recording.rrd.drawn_later import POSES, DrawnLater, Stream
from mbcacq.recording.rrd.kept_cloud import kept_cloud
from mbcacq.recording.rrd.measured_rows import exposure_row, observation_rows, scan_row, sweep_row, text_row
from mbcacq.recording.rrd.new_stream import send_default_blueprint
from mbcacq.recording.rrd.packed_cloud import packable
from mbcacq.recording.rrd.run_header import RunHeader, read_run_header, write_run_header
from mbcacq.recording.rrd.sink import Sink
from mbcacq.recording.rrd.urdf_arm import UrdfArm

START_FREE_BYTES = 256 << 20
FORECAST_AFTER = 3  # poses from whose size the size of the run is predicted
LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


class Recorder:
    """Call it with events, in order, from any thread; each is on its way to the file when the call returns, a pose is in the file.

    folder: the run folder, which exists. part: 0 for a new run, else how many recordings the folder holds already (a resumed
    run goes into a file of its own with the same recording id). live: serve a viewer on 127.0.0.1 as well, see ``live_url``.
    all_points: keep whole clouds, not only the points of the balls with a thinned rest. weighed: of an investigation, what is known before.
    Raises RecordingError if the file cannot be made or the disk fills; what was written until then stays readable.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        live: bool = False,
        part: int = 0,
        port: int = 9876,
        all_points: bool = True,
        weighed: WeighedPoses | None = None,
    ) -> None:
        folder = Path(folder)
        self.path, self._part = folder / layout.part_name(part), part
        try:
            folder.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(folder).free
        except OSError as error:
            raise RecordingError(f"the run folder {folder} cannot be made: {error.strerror}; choose another --out") from error
        if self.path.exists():
            raise RecordingError(f"{self.path} exists already; record into another folder, or resume the run")
        if free < START_FREE_BYTES:
            raise RecordingError(
                f"only {free >> 20} MiB are free for {self.path}, {START_FREE_BYTES >> 20} MiB are needed to start; "
                "free some space or choose another --out"
            )
        header = read_run_header(folder) if part else None
        self._first_start = datetime.fromisoformat(header.started) if header else None
        self.recording_id = header.recording_id if header else str(uuid.uuid4())
        self._sink = Sink(self.path, self.recording_id, live=live, port=port, blueprint=blueprint(live=live))
        self._rec = self._sink.stream
        self._drawn = DrawnLater(self._rec, at_once=live)
        self._live = live
        self._cycles = CycleWriter(self._rec, live=live)
        self._all_points, self._weighed = all_points, weighed
        self._held: events.ScanTaken | None = None  # a cloud whose balls are not known yet
        self._lock = threading.RLock()
        self._offset = 0.0  # of this part's clock to the run's
        self._clock = np.inf  # time.monotonic() at the start of this part
        self._pose: int | None = None
        self._step: int | None = None
        self._started_s: float | None = None  # POSIX time of run time 0
        self._cell: Cell | None = None
        self._T_base_scanner = np.eye(4)
        self._drawing = Drawing(self._drawn)
        self._said_health: dict[str, int | None] = {}  # device -> pose
        self._n_poses, self._done = 0, 0
        self._failed = False

    @property
    def live_url(self) -> str | None:
        """Where a viewer can connect, or None."""
        return self._sink.live_url

    def __call__(self, event: events.Event) -> None:
        with self._lock:
            if self._failed:
                return
            self._clock = min(self._clock, time.monotonic() - event.time_s)
            try:
                self._set_times(event.time_s)
                self._write(event)
            except Aborted:  # a signal came here: the run ends, and its end must be recorded
                raise
            except MbcacqError:
                self._failed = True
                raise
            except Exception as error:
                self._failed = True
                self._sink.stop_writing()
                raise RecordingError(
                    f"{type(event).__name__} cannot be recorded in {self.path}: {error}; what came before is kept"
                ) from error

    def close(self) -> None:
        """Complete the file. Idempotent."""
        with self._lock:
            if not self._failed:
                self._draw()
            self._sink.close()

    def _draw(self) -> None:
        """Write what was kept back for display."""
        self._cycles.show(self._cell)
        self._drawn.write()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _set_times(self, time_s: float) -> None:
        self._drawn.set_time(layout.TIME, duration=time_s + self._offset)
        if self._started_s is not None:
            self._drawn.set_time(layout.CLOCK, timestamp=self._started_s + time_s + self._offset)
        if self._step is not None:
            self._drawn.set_time(layout.STEP_INDEX, sequence=self._step)
        if self._pose is not None:
            self._drawn.set_time(layout.POSE, sequence=self._pose)

    @singledispatchmethod
    def _write(self, event: events.Event) -> None:
        """An event this recorder knows nothing about is left to the other subscribers."""

    @_write.register
    def _(self, event: events.RunStarted) -> None:
        self._cell, self._n_poses = parse_cell(event.cell_yaml), event.n_poses
        if self._first_start is not None:
            self._offset = (datetime.fromisoformat(event.started) - self._first_start).total_seconds()
        else:
            write_run_header(self.path.parent, RunHeader(self.recording_id, event.started, event.name))
        self._started_s = (self._first_start or datetime.fromisoformat(event.started)).timestamp()
        self._cycles.started(self._started_s)
        self._set_times(event.time_s)
        rec = self._rec
        rec.send_recording_name(drawable(f"{event.name} (simulated)" if event.simulated else event.name))
        texts = {layout.PLAN: event.plan_yaml, layout.CELL: event.cell_yaml, layout.CELL_COPY: event.cell_yaml}
        for entity, text in {**texts, **({layout.PLAN_FILES: event.plan_files} if event.plan_files else {})}.items():
            rec.log(entity, rr.TextDocument(text), text_row(text), static=True)
        scene.log_texts(rec, event.plan_yaml, event.cell_yaml)
        about = rows.row(
            layout.RUN_ARCHETYPE,
            layout=layout.VERSION,
            name=event.name,
            started=event.started,
            n_poses=event.n_poses,
            offset_s=self._offset,
            simulated=True if event.simulated else None,
            versions_names=list(event.versions),
            versions_values=list(event.versions.values()),
        )
        rec.log(layout.RUN, about, static=True)
        if event.simulated:
            self._say(event.time_s, SIMULATED, "WARN")
        panels = Enlarged(investigated=self._weighed is not None)
        shown = for_cell(self._cell, event.plan_yaml, panels, live=bool(self.live_url))
        send_default_blueprint(rec, shown)
        self._draw_from_urdf(event.urdf, self._cell, event.time_s)
        scene.log_static(rec, self._cell, event.plan_yaml, links=self._cycles.urdf is None)
        self._log_arm(rec, self._cell, scene.home(event.plan_yaml, self._cell.robot.n))
        self._drawing.start(self._cell, event)
        if self._weighed is not None:
            log_choice(rec, self._weighed)
        self._sink.flush()

    def _say(self, time_s: float, text: str, level: str) -> None:
        """A line of the log. Its time is part of the text: the viewer's own column of it is too narrow to be read."""
        self._rec.log(layout.LOG, rr.TextLog(drawable(f"{time_s:.1f} s  {text}"), level=level))

    def _draw_from_urdf(self, path: str, cell: Cell, time_s: float) -> None:
        """A URDF that does not fit is no reason not to measure: a warning is logged, and the arm is drawn from its links."""
        if path:
            try:
                self._cycles.urdf = UrdfArm(path, cell)
                self._cycles.urdf.start(self._rec)
            except ConfigError as error:
                self._say(time_s, str(error), "WARN")

    def _log_arm(self, stream: Stream, cell: Cell, q: np.ndarray) -> None:
        scene.log_arm(stream, cell, q)
        if self._cycles.urdf is not None:
            self._cycles.urdf.pose(stream, q[None])

    @_write.register
    def _(self, event: events.StateChanged) -> None:
        self._rec.log(layout.STATE, rr.StateChange(state=event.state))

    @_write.register
    def _(self, event: events.StepStarted) -> None:
        self._step = event.index
        self._set_times(event.time_s)
        self._rec.log(layout.STEP, rr.StateChange(state=drawable(event.name)))

    @_write.register
    def _(self, event: events.StationReached) -> None:
        self._drawing.station(event)
        self._rec.log(layout.STATION, rr.StateChange(state=drawable(f"{event.station}: {event.artefact}")))

    @_write.register
    def _(self, event: events.Message) -> None:
        text = event.text if event.source == "mbcacq" else f"{event.source}: {event.text}"
        self._say(event.time_s, text, LEVELS.get(event.level, event.level.upper()))
        self._sink.flush()

    @_write.register
    def _(self, event: events.HealthReceived) -> None:
        if self._pose is not None and self._said_health.get(event.device) == self._pose:
            return  # once a pose says it: every further row costs 2 kB
        self._said_health[event.device] = self._pose
        for name, value in event.values.items():
            entity = "/".join(rr.escape_entity_path_part(part) for part in (layout.HEALTH, event.device, name))
            self._drawn.log(entity, rr.Scalars(float(value)))
        self._drawing.temperatures(event.values, event.device)

    @_write.register
    def _(self, event: events.CyclesReceived) -> None:
        if len(event.cycles):
            self._cycles.write(event.cycles, event.time_s, self._clock, self._offset, self._cell)
            self._sink.push()

    @_write.register
    def _(self, event: events.PoseReached) -> None:
        self._pose = event.pose
        self._set_times(event.time_s)
        if self._live:
            self._cycles.show(self._cell)
        if self._cell is not None:
            self._T_base_scanner = self._cell.robot.chain.flange(event.q[None])[0] @ self._cell.T_flange_scanner
            self._log_arm(self._drawn, self._cell, event.q)
            self._drawing.reached(event)

    @_write.register
    def _(self, event: events.ScanTaken) -> None:
        self._sink.check_space(event.scan.points.nbytes + 9 * len(event.scan.points))
        self._let_go()
        self._drawing.taken(event)
        if self._all_points or self._cell is None:
            self._write_scan(event)
        else:
            self._held = event

    @_write.register
    def _(self, event: events.SweepTaken) -> None:
        self._sink.check_space(event.profiles.points.nbytes + 48 * len(event.profiles))
        self._rec.log(layout.SWEEP, sweep_row(event, self._part))

    def _let_go(self) -> None:
        """Write a held cloud as it came: its balls were never looked for."""
        if self._held is not None:
            held, self._held = self._held, None
            self._write_scan(held)

    def _write_scan(self, event: events.ScanTaken) -> None:
        pack = not self._all_points and packable(event.scan)
        points = [] if pack else [rr.Points3D(event.scan.points)]
        self._rec.log(layout.SCAN, scene.placed(self._T_base_scanner), *points, scan_row(event, pack=pack))

    @_write.register
    def _(self, event: events.CentresFound) -> None:
        if self._held is not None and (artefact := self._drawing.artefact) is not None:
            kept = kept_cloud(self._held.scan, artefact, event.ball, event.xyz, event.exposure)
            self._held = replace(self._held, scan=kept)
        self._let_go()
        self._rec.log(layout.EXPOSURE, exposure_row(event))
        self._drawing.found(event)

    @_write.register
    def _(self, event: events.PoseDone) -> None:
        self._let_go()
        self._rec.log(layout.OBSERVATION, *observation_rows(event, self._part, event.time_s + self._offset))
        self._drawing.done(event)
        self._drawn.log(layout.BALLS_FOUND, rr.Scalars(len(event.ball)))
        if len(event.ball):
            self._drawn.log(layout.FIT_RMS, rr.Scalars(1e3 * float(np.mean(event.rms_mm))))
            self._drawn.log(layout.SCATTER, rr.Scalars(1e3 * float(np.sqrt(np.mean(np.square(event.scatter_mm))))))
        self._done += 1
        if self._done % POSES == 0:
            self._draw()
        self._sink.flush(event.pose)
        if self._done == FORECAST_AFTER:
            self._sink.check_predicted_size(self._done, self._n_poses)

    @_write.register
    def _(self, event: events.RunStopped) -> None:
        self._let_go()
        self._draw()
        level = "INFO" if event.exit_status == "success" else "ERROR"
        self._rec.log(layout.RUN, rows.row(layout.RUN_ARCHETYPE, exit_status=event.exit_status, reason=event.reason))
        self._say(event.time_s, f"run ended: {event.exit_status}: {event.reason}", level)
        self._sink.flush()
