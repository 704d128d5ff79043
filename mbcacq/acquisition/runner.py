"""Executes the poses of a plan. The only place that moves a robot; whatever happens, the robot ends at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.cell_devices import CellDevices
from mbcacq.acquisition.cycle_collector import CycleCollector
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.expected_view import mean_centres, predicted_centres
from mbcacq.acquisition.monitor import RobotMonitor
from mbcacq.acquisition.mover import Mover
from mbcacq.acquisition.placement import PlacementCheck
from mbcacq.acquisition.reconnect_policy import ReconnectingScanner, read_sensor
from mbcacq.devices import Aborted, DeviceFault, MbcacqError, SafetyStop
from mbcacq.plan import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.motion_limits import motion_limits

MISSED_SHARE = 0.2  # of the poses; more than that seen without enough balls ends the run
PLACINGS = 3  # how often an operator is asked to put the artefact where it belongs


class Pause(Protocol):
    """Asks before each pose of a stepped run."""

    def wait(self, pose: PlannedPose, n_poses: int) -> None:
        """Return to go on. Raises Aborted to end the run, also after ``stop``."""

    def stop(self) -> None:
        """End the wait, from any thread."""


class Misplaced(DeviceFault):
    """The artefact does not stand where the plan says."""


@dataclass
class Runner:
    """One run. ``paths[k]`` is the way to ``poses[k]`` from the pose before it (the first: from home), ``way_home`` joint waypoints (n,)
    rad from the last pose to home, home included; ``done``: numbers of poses to skip (resume).

    ``find_balls(scan points (N, 3), artefact, expected=, predicted=)`` extracts the centres. ``confirm`` is asked once, with
    the measured joints, before anything moves; it raises to refuse. ``pause`` is asked before each pose. ``known``: station -> ball ->
    place (3,) mm in the base frame, as measured before a resume.
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
    pause: Pause | None = None
    known: Mapping[str, Mapping[int, np.ndarray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._placement = PlacementCheck(self.loaded.cell, self.loaded.plan.station_tolerance_mm, self.known)
        self._scanner = ReconnectingScanner(
            self.devices.scanner, self.devices.robot, self.loaded.plan.scanner.reconnect_s, lambda text: self._say("warning", text)
        )
        self._limits = motion_limits(self.loaded)

    def run(self) -> None:
        """Connect, measure every pose, stop. Emits RunStopped in every case, then raises what ended the run early."""
        plan = self.loaded.plan
        started = datetime.now(UTC).isoformat(timespec="seconds")
        self.bus.emit(
            events.RunStarted,
            plan.name,
            started,
            self.loaded.text,
            self.cell_yaml,
            len(self.poses),
            self.versions,
            self._route(),
            str(self.loaded.path.parent / plan.robot.urdf) if plan.robot.urdf else "",
        )
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
            self._finish_early("abort", error, str(error) or "interrupted by the operator")
            raise
        except BaseException as error:
            told = str(error) if isinstance(error, MbcacqError) else f"unexpected {type(error).__name__}: {error}"
            self._finish_early("fail", error, told)
            raise
        self._finish("success", summary)

    def _route(self) -> dict[int, np.ndarray]:
        legs = zip(self.poses, self.paths, strict=True)
        return {pose.number: np.array([*path, pose.q]) for pose, path in legs if pose.number not in self.done}

    def _measure(self) -> str:
        robot = self.devices.robot
        with CycleCollector(robot, self.bus) as pump, ExitStack() as stack:
            stack.callback(robot.stop)  # before the pump is waited for, which may hang on a slow disk
            self.confirm(robot.state().q)
            mover = Mover(robot, self.loaded.cell, self._limits, pump)
            self._pass([self.way_home[-1]], mover)
            station = step = None
            missed = 0
            for pose, path in zip(self.poses, self.paths, strict=True):
                if pose.number in self.done:
                    continue
                if pose.step != step:
                    step = pose.step
                    self.bus.emit(events.StepStarted, step, pose.step_name, sum(p.step == step for p in self.poses))
                self._pause(pose)
                self._pass(path.leave, mover)
                if pose.station != station:
                    station = pose.station
                    seen = self._observe_first(pose, path, mover, pump)
                else:
                    self._pass(path.approach, mover)
                    seen = self._observe(pose, mover, pump)
                if not seen:
                    missed += 1
                    if missed > max(1, MISSED_SHARE * len(self.poses)):
                        raise DeviceFault(f"{missed} poses showed too few balls; look at the scans, the exposure and the artefact's place")
            self._pass(self.way_home, mover)
            if pump.missing:
                self._gap("cycles", f"{pump.missing} robot cycles are missing in the recording; the network lost them")
        late = "" if pump.late is None else f", {pump.late} of them answered late"
        lost = f", {pump.missing} more missing" if pump.missing else ""
        again = f"; the scanner was lost {self._scanner.losses} times and came back" if self._scanner.losses else ""
        few = f", {missed} of them without enough balls" if missed else ""
        return f"all poses measured{few}; {pump.count} robot cycles{late}{lost}{again}"

    def _pass(self, waypoints: Sequence[np.ndarray], mover: Mover) -> None:
        if waypoints:
            self._state("moving")
        for waypoint in waypoints:
            mover.go(waypoint)

    def _pause(self, pose: PlannedPose) -> None:
        if self.pause is not None:
            self._state("paused")
            with RobotMonitor(self.devices.robot, self.pause.stop):
                self.pause.wait(pose, len(self.poses))

    def _place(self, pose: PlannedPose) -> None:
        self._state("waiting")
        artefact = self.loaded.cell.artefact(pose.artefact)
        positioner = self.devices.positioner
        with RobotMonitor(self.devices.robot, positioner.stop):
            positioner.go_to(pose.station, f"place '{artefact.name or artefact.id}' at station {pose.station}")
        self.bus.emit(events.StationReached, pose.station, pose.artefact)

    def _observe_first(self, pose: PlannedPose, path: Transit, mover: Mover, pump: CycleCollector) -> bool:
        """Have the artefact placed, and look whether it is; a person is asked again, after the arm went back the way it came."""
        asks = getattr(self.devices.positioner, "asks", False)
        for left in reversed(range(PLACINGS if asks else 1)):
            self._place(pose)
            self._pass(path.approach, mover)
            try:
                return self._observe(pose, mover, pump, first=True)
            except Misplaced as error:
                if not left:
                    raise
                self._say("warning", str(error))
                self._pass([*reversed(path.approach), self.way_home[-1]], mover)
        raise AssertionError("unreachable")

    def _observe(self, pose: PlannedPose, mover: Mover, pump: CycleCollector, first: bool = False) -> bool:
        """Measure one pose, ``first`` at its station. Returns whether enough balls were found. Raises Misplaced."""
        about = (pose.number, pose.station, pose.phase, pose.step_name)
        for left in (1, 0):
            self._state("moving")
            reached = mover.go(pose.q)
            self.bus.emit(events.PoseReached, *about, reached.q, mover.direction, reached.time_s)
            self._state("scanning")
            pump.mark()
            found = [self._expose(pose, 0)]
            if first:
                self._check_place(pose, reached.q, found[0])
            found += [self._expose(pose, k) for k in range(1, pose.exposures)]
            now = self.devices.robot.state()  # raises what stopped the arm meanwhile
            cycles = pump.since_mark()
            if self._stood(cycles, pose, left):
                break
        q = cycles["q"].mean(axis=0) if cycles else now.q
        current = cycles["current_percent"].mean(axis=0) if "current_percent" in cycles else None
        sensors = self._read_sensors(pose)
        mean = mean_centres(found)
        if len(mean.ball) < self._fewest_balls(pose):
            self._gap(
                "pose",
                f"pose {pose.number} ({pose.step_name}): {len(mean.ball)} of {len(pose.balls)} balls found, pose left out",
                pose.number,
            )
            return False
        self.bus.emit(
            events.PoseDone,
            *about,
            q,
            mover.direction.copy(),
            reached.time_s,
            mean.ball,
            mean.xyz,
            mean.n_points,
            mean.rms_mm,
            mean.scatter_mm,
            len(found),
            current,
            sensors,
        )
        return True

    def _check_place(self, pose: PlannedPose, q: np.ndarray, found) -> None:
        if len(found.ball) == 0 and not getattr(self.devices.positioner, "asks", False):
            return  # nobody to ask: the pose is left out, and more of them end the run
        if sentence := self._placement.fault(pose, q, found.ball, found.xyz):
            raise Misplaced(sentence)

    def _stood(self, cycles: Mapping[str, np.ndarray], pose: PlannedPose, left: int) -> bool:
        """Whether the arm stood during the exposures of a pose. Raises SafetyStop if it did not, a second time."""
        moved = float(np.max(np.ptp(cycles["q"], axis=0))) if cycles else 0.0
        if moved <= 2 * self._limits.tolerance:
            return True
        text = f"the arm moved by {np.degrees(moved):.3f} deg during the exposures of pose {pose.number}"
        if not left:
            raise SafetyStop(f"{text}, twice; its brakes or its controller do not hold it, so the run was ended")
        self._say("warning", f"{text}; it is measured again")
        return False

    def _fewest_balls(self, pose: PlannedPose) -> int:
        return min(self.loaded.plan.accept.min_balls, len(pose.balls))

    def _expose(self, pose: PlannedPose, exposure: int):
        scan = self._scanner.capture(self.loaded.plan.scanner.exposure_us)
        self.bus.emit(events.ScanTaken, pose.number, exposure, scan)
        if scan.health:
            self.bus.emit(events.HealthReceived, "scanner", dict(scan.health))
        for warning in scan.warnings:
            self._say("warning", f"pose {pose.number}: {warning}")
        artefact = self.loaded.cell.artefact(pose.artefact)
        predicted = predicted_centres(self.loaded.cell, pose)
        found = self.find_balls(scan.points, artefact, expected=pose.balls, predicted=predicted)
        self.bus.emit(events.CentresFound, pose.number, exposure, found.ball, found.xyz, found.n_points, found.rms_mm)
        return found

    def _read_sensors(self, pose: PlannedPose) -> dict[str, float]:
        values: dict[str, float] = {}
        for number, (sensor, use) in enumerate(zip(self.devices.sensors, self.loaded.plan.sensors, strict=True), 1):
            try:
                values.update(read_sensor(sensor))
            except MbcacqError as error:
                if use.required:
                    raise
                names = ", ".join(f.name for f in sensor.describe().fields)
                self._gap("sensor", f"sensor {number}: {error}; pose {pose.number} has no {names}", pose.number)
        return values

    def _describe(self) -> None:
        for name, device in self.devices.all.items():
            about = device.describe()
            self._say("info", " ".join(part for part in (f"{name}:", about.model, about.serial, about.firmware) if part))

    def _state(self, state: str) -> None:
        self.bus.emit(events.StateChanged, state)

    def _say(self, level: str, text: str) -> None:
        self.bus.emit(events.Message, level, text)

    def _gap(self, kind: str, text: str, pose: int | None = None) -> None:
        self.bus.emit(events.Gap, kind, text, pose)
        self._say("warning", text)

    def _finish_early(self, status: str, error: BaseException, reason: str) -> None:
        """Close the recording; what ended the run stays what is reported, even where the recording cannot be closed any more."""
        try:
            self._finish(status, reason)
        except MbcacqError as second:
            if isinstance(error, MbcacqError) and str(second) != str(error):
                error.args = (f"{error}; and the end of the run could not be recorded: {second}",)

    def _finish(self, status: str, reason: str) -> None:
        self._state("stopped")
        self.bus.emit(events.RunStopped, status, reason)
