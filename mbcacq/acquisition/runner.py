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
from mbcacq.acquisition.fact_watch import FactWatch
from mbcacq.acquisition.follower import Follower
from mbcacq.acquisition.gate_options import GateOptions
from mbcacq.acquisition.gated_exposures import BallFinder, GatedExposures, Misplaced
from mbcacq.acquisition.monitor import RobotMonitor
from mbcacq.acquisition.mover import Mover
from mbcacq.acquisition.placement import PlacementCheck
from mbcacq.acquisition.pose_measurement import PoseMeasurement
from mbcacq.acquisition.reconnect_policy import ReconnectingScanner
from mbcacq.devices import Aborted, DeviceFault, MbcacqError
from mbcacq.plan import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.motion_limits import motion_limits

MISSED_SHARE = 0.2  # of the poses; more than that without enough balls ends the run
PLACINGS = 3  # how often an operator is asked to put the artefact where it belongs


class Pause(Protocol):
    """Asks before each pose of a stepped run."""

    def wait(self, pose: PlannedPose, n_poses: int) -> None:
        """Return to go on. Raises Aborted to end the run, also after ``stop``."""
        ...

    def stop(self) -> None:
        """End the wait, from any thread."""
        ...


@dataclass
class Runner:
    """One run. ``paths[k]`` leads to ``poses[k]`` from the pose before it (the first: from home), ``path_home`` are joint waypoints (n,)
    rad from the last pose to home, home included; ``done``: numbers of poses to skip (resume).

    ``find_balls`` extracts the centres of a scan. ``confirm`` is asked once, with the measured joints, before anything moves; it raises
    to refuse. ``pause`` is asked before each pose. ``known``: station -> ball -> place (3,) mm in the base frame, as measured before a
    resume. ``facts``: what the devices reported then. ``simulated``: the devices are fakes. ``plan_files``: see
    ``mbcacq.acquisition.events.RunStarted``.
    """

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    paths: Sequence[Transit]
    path_home: Sequence[np.ndarray]
    devices: CellDevices
    bus: EventBus
    find_balls: BallFinder
    cell_yaml: str
    versions: dict[str, str] = field(default_factory=dict)
    confirm: Callable[[np.ndarray], None] = lambda q: None
    done: frozenset[int] = frozenset()
    pause: Pause | None = None
    known: Mapping[str, Mapping[int, np.ndarray]] = field(default_factory=dict)
    simulated: bool = False
    gates: GateOptions = GateOptions()
    plan_files: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)

    def run(self) -> None:
        """Connect, measure every pose, stop. Emits RunStopped in every case, then raises what ended the run early."""
        self._announce()
        try:
            self.bus.state("connecting")
            self.devices.connect()
            self._describe()
            try:
                summary = self._measure_all()
            finally:
                self.devices.robot.stop()
                self.devices.close()
        except (KeyboardInterrupt, Aborted) as error:
            self._finish_early("abort", error, str(error) or "interrupted by the operator")
            raise
        except BaseException as error:
            reason = str(error) if isinstance(error, MbcacqError) else f"unexpected {type(error).__name__}: {error}"
            self._finish_early("fail", error, reason)
            raise
        self._finish("success", summary)

    def _announce(self) -> None:
        plan = self.loaded.plan
        left = [(pose, path) for pose, path in zip(self.poses, self.paths, strict=True) if pose.number not in self.done]
        self.bus.emit(
            events.RunStarted,
            name=plan.name,
            started=datetime.now(UTC).isoformat(timespec="seconds"),
            plan_yaml=self.loaded.text,
            cell_yaml=self.cell_yaml,
            n_poses=len(self.poses),
            versions=self.versions,
            route={pose.number: np.array([*path, pose.q]) for pose, path in left},
            urdf=str(self.loaded.path.parent / plan.robot.urdf) if plan.robot.urdf else "",
            simulated=self.simulated,
            plan_files=self.plan_files,
        )

    def _describe(self) -> None:
        for name, device in self.devices.all.items():
            about = device.describe()
            self.bus.emit(events.DeviceConnected, name, f"{type(device).__module__}:{type(device).__name__}", about)
            self.bus.message("info", " ".join(part for part in (f"{name}:", about.model, about.serial, about.firmware) if part))
            if about.settings:
                self.bus.message("info", f"{name}: " + "; ".join(f"{key}: {value}" for key, value in about.settings.items()))

    def _measure_all(self) -> str:
        """Home, every pose, home. Returns one sentence on how it went."""
        robot, plan = self.devices.robot, self.loaded.plan
        scanner = ReconnectingScanner(self.devices.scanner, robot, plan.scanner.reconnect_s, lambda text: self.bus.message("warning", text))
        placement = PlacementCheck(self.loaded.cell, plan.station_tolerance_mm, self.known)
        facts = FactWatch(self.devices.all, self.bus, self.facts)
        facts.look()
        with CycleCollector(robot, self.bus, facts.look) as collector, ExitStack() as stack:
            stack.callback(robot.stop)  # before the collector is waited for, which may hang on a slow disk
            self.confirm(robot.state().q)
            mover = self._mover(collector)
            exposures = GatedExposures(
                self.loaded, self.bus, scanner, self.find_balls, placement, self.gates, asks_a_person=self.devices.asks_a_person
            )
            measurement = PoseMeasurement(self.loaded, self.devices, self.bus, exposures, mover, collector, facts, options=self.gates)
            self._pass([self.path_home[-1]], mover)
            missed = self._measure_poses(measurement, mover)
            self._pass(self.path_home, mover)
            if collector.missing:
                self.bus.gap("cycles", f"{collector.missing} robot cycles are missing in the recording; the network lost them")
        late = "" if collector.late is None else f", {collector.late} of them answered late"
        lost = f", {collector.missing} more missing" if collector.missing else ""
        again = f"; the scanner was lost {scanner.losses} times and came back" if scanner.losses else ""
        wrong = len(measurement.left_out)
        few = f", {missed - wrong} of them without enough balls" if missed > wrong else ""
        few += f", {wrong} of them left out by the checks (pose {', '.join(map(str, measurement.left_out))})" if wrong else ""
        few += mover.summary()
        return f"all poses measured{few}; {collector.count} robot cycles{late}{lost}{again}"

    def _measure_poses(self, measurement: PoseMeasurement, mover: Mover | Follower) -> int:
        """Returns how many poses were left out. Raises DeviceFault if these become too many."""
        station = step = None
        missed = 0
        for pose, path in zip(self.poses, self.paths, strict=True):
            if pose.number in self.done:
                continue
            if pose.step != step:
                step = pose.step
                self.bus.emit(events.StepStarted, step, pose.step_name, sum(p.step == step for p in self.poses))
            self._pause(pose)
            self._pass(path.retract, mover)
            if pose.station != station:
                station = pose.station
                measured = self._measure_first(pose, path, measurement, mover)
            else:
                self._pass(path.approach, mover)
                measured = measurement.measure(pose)
            if not measured:
                missed += 1
                if missed > max(1, MISSED_SHARE * len(self.poses)):
                    raise DeviceFault(
                        f"{missed} poses showed too few balls or failed the checks{measurement.last_reason}; look at the scans, exposure "
                        "and artefact"
                    )
        return missed

    def _measure_first(self, pose: PlannedPose, path: Transit, measurement: PoseMeasurement, mover: Mover | Follower) -> bool:
        """Have the artefact placed, and check from the first pose whether it is; a person is asked again, after the arm went home."""
        for left in reversed(range(PLACINGS if self.devices.asks_a_person else 1)):
            self._place(pose)
            self._pass(path.approach, mover)
            try:
                return measurement.measure(pose, first=True)
            except Misplaced as error:
                if not left:
                    raise
                self.bus.message("warning", str(error))
                self._pass([*reversed(path.approach), self.path_home[-1]], mover)
        raise AssertionError("unreachable")

    def _place(self, pose: PlannedPose) -> None:
        self.bus.state("waiting")
        artefact = self.loaded.cell.artefact(pose.artefact)
        positioner = self.devices.positioner
        with RobotMonitor(self.devices.robot, positioner.stop):
            positioner.go_to(pose.station, f"place '{artefact.name or artefact.id}' at station {pose.station}")
        self.bus.emit(events.StationReached, pose.station, pose.artefact)

    def _pause(self, pose: PlannedPose) -> None:
        if self.pause is not None:
            self.bus.state("paused")
            with RobotMonitor(self.devices.robot, self.pause.stop):
                self.pause.wait(pose, len(self.poses))

    def _pass(self, waypoints: Sequence[np.ndarray], mover: Mover | Follower) -> None:
        if waypoints:
            self.bus.state("moving")
        for waypoint in waypoints:
            mover.pass_by(waypoint)

    def _mover(self, collector: CycleCollector) -> Mover | Follower:
        """What brings the arm to a pose, or waits until it stands there."""
        limits, follow = motion_limits(self.loaded), self.loaded.plan.robot.follow
        if follow is None:
            return Mover(self.devices.robot, self.loaded.cell, limits, collector)
        still = self.gates.standstill_tolerances * limits.tolerance
        return Follower(self.devices.robot, limits, collector, follow, still, self.bus, self.devices.lead)

    def _finish_early(self, status: str, error: BaseException, reason: str) -> None:
        """Close the recording; what ended the run stays what is reported, even where the recording cannot be closed any more."""
        try:
            self._finish(status, reason)
        except MbcacqError as second:
            if isinstance(error, MbcacqError) and str(second) != str(error):
                error.args = (f"{error}; and the end of the run could not be recorded: {second}",)

    def _finish(self, status: str, reason: str) -> None:
        self.bus.state("stopped")
        self.bus.emit(events.RunStopped, status, reason)
