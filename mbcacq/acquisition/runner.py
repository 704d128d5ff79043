"""Executes the poses of a plan. The only place that moves a robot; whatever happens, the robot ends at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.bus import EventBus
from mbcacq.acquisition.cell_devices import CellDevices
from mbcacq.acquisition.motion import Mover, motion_limits
from mbcacq.acquisition.observe import mean_centres, predicted_centres
from mbcacq.acquisition.pump import CyclePump
from mbcacq.devices import Aborted, DeviceFault, MbcacqError
from mbcacq.plan import LoadedPlan, PlannedPose, Transit

MISSED_SHARE = 0.2  # of the poses; more than that seen without enough balls ends the run


@dataclass
class Runner:
    """One run. ``paths[k]`` is the way to ``poses[k]`` from the pose before it (the first: from home), ``way_home`` joint waypoints (n,)
    rad from the last pose to home, home included; ``done``: numbers of poses to skip (resume).

    ``find_balls(scan points (N, 3), artefact, expected=, predicted=)`` extracts the centres. ``confirm`` is asked once, with
    the measured joints, before anything moves; it raises to refuse.
    """

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    paths: Sequence[Transit]
    way_home: Sequence[np.ndarray]
    devices: CellDevices
    bus: EventBus
    find_balls: Callable
    cell_yaml: str
    versions: dict[str, str] = field(default_factory=dict)
    confirm: Callable[[np.ndarray], None] = lambda q: None
    done: frozenset[int] = frozenset()

    def run(self) -> None:
        """Connect, measure every pose, stop. Emits RunStopped in every case, then raises what ended the run early."""
        plan = self.loaded.plan
        started = datetime.now(UTC).isoformat(timespec="seconds")
        self.bus.emit(events.RunStarted, plan.name, started, self.loaded.text, self.cell_yaml, len(self.poses), self.versions)
        try:
            self._state("connecting")
            self.devices.connect()
            self._describe()
            try:
                summary = self._measure()
            finally:
                self.devices.robot.stop()
                self.devices.close()
        except (KeyboardInterrupt, Aborted) as error:
            self._finish("abort", str(error) or "interrupted by the operator")
            raise
        except BaseException as error:
            self._finish("fail", str(error) if isinstance(error, MbcacqError) else f"unexpected {type(error).__name__}: {error}")
            raise
        self._finish("success", summary)

    def _measure(self) -> str:
        robot = self.devices.robot
        with CyclePump(robot, self.bus) as pump, ExitStack() as stack:
            stack.callback(robot.stop)  # before the pump is waited for, which may hang on a slow disk
            self.confirm(robot.state().q)
            mover = Mover(robot, self.loaded.cell.robot.limits, motion_limits(self.loaded), pump)
            self._pass([self.way_home[-1]], mover)
            station = step = None
            missed = 0
            for pose, path in zip(self.poses, self.paths, strict=True):
                if pose.number in self.done:
                    continue
                if pose.step != step:
                    step = pose.step
                    self.bus.emit(events.StepStarted, step, pose.step_name, sum(p.step == step for p in self.poses))
                self._pass(path.leave, mover)
                if pose.station != station:
                    station = pose.station
                    self._place(pose)
                self._pass(path.approach, mover)
                if not self._observe(pose, mover, pump):
                    missed += 1
                    if missed > max(1, MISSED_SHARE * len(self.poses)):
                        raise DeviceFault(f"{missed} poses showed too few balls; look at the scans, the exposure and the artefact's place")
            self._pass(self.way_home, mover)
        late = "" if pump.late is None else f", {pump.late} of them answered late"
        return f"all poses measured, {missed} of them without enough balls; {pump.count} robot cycles{late}"

    def _pass(self, waypoints: Sequence[np.ndarray], mover: Mover) -> None:
        if waypoints:
            self._state("moving")
        for waypoint in waypoints:
            mover.go(waypoint)

    def _place(self, pose: PlannedPose) -> None:
        self._state("waiting")
        artefact = self.loaded.cell.artefact(pose.artefact)
        self.devices.positioner.go_to(pose.station, f"place '{artefact.name or artefact.id}' at station {pose.station}")
        self.bus.emit(events.StationReached, pose.station, pose.artefact)

    def _observe(self, pose: PlannedPose, mover: Mover, pump: CyclePump) -> bool:
        """Measure one pose. Returns whether enough balls were found."""
        self._state("moving")
        reached = mover.go(pose.q)
        about = (pose.number, pose.station, pose.phase, pose.step_name)
        self.bus.emit(events.PoseReached, *about, reached.q, mover.direction, reached.time_s)
        self._state("scanning")
        pump.mark()
        found = [self._expose(pose, k) for k in range(pose.exposures)]
        cycles = pump.since_mark()
        q = cycles["q"].mean(axis=0) if cycles else self.devices.robot.state().q
        current = cycles["current_percent"].mean(axis=0) if "current_percent" in cycles else None
        sensors = self._read_sensors()
        mean = mean_centres(found)
        if len(mean.ball) < self._fewest_balls(pose):
            self._say("warning", f"pose {pose.number} ({pose.step_name}): {len(mean.ball)} of {len(pose.balls)} balls found, pose left out")
            return False
        self.bus.emit(
            events.PoseDone, *about, q, mover.direction.copy(), reached.time_s, mean.ball, mean.xyz, mean.n_points,
            mean.rms_mm, mean.scatter_mm, len(found), current, sensors,
        )
        return True

    def _fewest_balls(self, pose: PlannedPose) -> int:
        return min(self.loaded.plan.accept.min_balls, len(pose.balls))

    def _expose(self, pose: PlannedPose, exposure: int):
        scan = self.devices.scanner.capture(self.loaded.plan.scanner.exposure_us)
        self.bus.emit(events.ScanTaken, pose.number, exposure, scan)
        if scan.health:
            self.bus.emit(events.HealthReceived, "scanner", dict(scan.health))
        artefact = self.loaded.cell.artefact(pose.artefact)
        predicted = predicted_centres(self.loaded.cell, pose)
        found = self.find_balls(scan.points, artefact, expected=pose.balls, predicted=predicted)
        self.bus.emit(events.CentresFound, pose.number, exposure, found.ball, found.xyz, found.n_points, found.rms_mm)
        return found

    def _read_sensors(self) -> dict[str, float]:
        values: dict[str, float] = {}
        for sensor in self.devices.sensors:
            values.update(sensor.read())
        return values

    def _describe(self) -> None:
        for name, device in self.devices.all.items():
            about = device.describe()
            self._say("info", " ".join(part for part in (f"{name}:", about.model, about.serial, about.firmware) if part))

    def _state(self, state: str) -> None:
        self.bus.emit(events.StateChanged, state)

    def _say(self, level: str, text: str) -> None:
        self.bus.emit(events.Message, level, text)

    def _finish(self, status: str, reason: str) -> None:
        self._state("stopped")
        self.bus.emit(events.RunStopped, status, reason)
