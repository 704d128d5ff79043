"""One pose measured: the arm moved there, exposures taken, balls found, sensors read, and all of it checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.cell_devices import CellDevices
from mbcacq.acquisition.cycle_collector import CycleCollector
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.fact_watch import FactWatch
from mbcacq.acquisition.follower import Follower
from mbcacq.acquisition.gate_options import GateOptions
from mbcacq.acquisition.gated_exposures import GatedExposures
from mbcacq.acquisition.mover import Mover
from mbcacq.acquisition.pose_observation import ArmAtPose, emit_observation
from mbcacq.acquisition.reconnect_policy import read_sensor
from mbcacq.acquisition.sweep_measurement import LEAST_PROFILES, StreamBroke, line_scanner, take_sweep
from mbcacq.devices import ConfigError, DeviceFault, MbcacqError, RobotState, SafetyStop
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.spheres.found import FoundSpheres

BUMPED = "was the artefact bumped or the scanner's mount? Put it right and resume the run with --again"


@dataclass
class PoseMeasurement:
    """Measures poses one by one, with the devices of a run that is going on."""

    loaded: LoadedPlan
    devices: CellDevices
    bus: EventBus
    exposures: GatedExposures
    mover: Mover | Follower
    collector: CycleCollector
    facts: FactWatch
    options: GateOptions = GateOptions()
    left_out: list[int] = field(default_factory=list)  # numbers of the poses whose exposures failed the checks
    last_reason: str = ""  # why the last of them was, as a clause
    _in_a_row: int = 0

    @property
    def fastest(self) -> np.ndarray:
        """(n,) rad/s: no axis turns faster."""
        speed = self.loaded.cell.robot.speed
        return self.mover.limits.speed if speed is None else speed

    def measure(self, pose: PlannedPose, first: bool = False) -> bool:
        """Move to a pose and measure it, ``first`` at its station. Returns whether enough balls were found.

        The pose is measured a second time where the arm moved during the exposures. Raises Misplaced, SafetyStop if the arm moved
        both times, and what the devices raise.
        """
        if pose.sweep is not None:
            return self._swept(pose)
        for left in (1, 0):
            reached = self._reach(pose)
            if self.loaded.plan.robot.follow is not None:
                pose = replace(pose, q=reached.q)  # taken where it stands
            self.collector.mark()
            found, contradiction = self.exposures.take(pose, reached.q, first)
            now = self.devices.robot.state()  # raises what stopped the arm meanwhile
            cycles = self.collector.since_mark()
            q = np.mean(cycles["q"], axis=0) if cycles else now.q
            if self._stood(cycles, q, pose, left):
                break
        current = cycles["current_percent"].mean(axis=0) if "current_percent" in cycles else None
        sensors = self._read_sensors(pose)
        facts = self.facts.values
        if changed := self.facts.since_mark():
            return self._leave_out(pose, changed, "set it back as it was, and resume the run")
        if contradiction:
            return self._leave_out(pose, contradiction, BUMPED)
        measured: ArmAtPose = {"q": q, "current": current, "sensors": sensors, "facts": facts}
        return self._done(pose, found, self.loaded.plan.accept.min_balls, reached, measured)

    def _reach(self, pose: PlannedPose) -> RobotState:
        self.bus.state("moving")
        reached, about = self.mover.go(pose.q), (pose.number, pose.station, pose.phase, pose.step_name)
        self.bus.emit(events.PoseReached, *about, reached.q, self.mover.direction, reached.time_s)
        self.bus.state("scanning")
        self.facts.mark()
        return reached

    def _done(self, pose: PlannedPose, found: Sequence[FoundSpheres], min_balls: int, reached: RobotState, measured: ArmAtPose) -> bool:
        arm: ArmAtPose = {"direction": self.mover.direction.copy(), "robot_time_s": reached.time_s, **measured}
        if not emit_observation(self.bus, pose, found, min_balls, pose.step_name, arm):
            return False
        self._in_a_row = 0
        return True

    def _swept(self, pose: PlannedPose) -> bool:
        """A sweep; its balls are found once all of them are there, with the clock of the scanner."""
        if not isinstance(self.mover, Mover):
            raise ConfigError("the run follows an arm that it does not move, which cannot sweep; leave out the steps 'sweep', or follow")
        scanner = line_scanner(self.devices.scanner)
        reached = self._reach(pose)
        try:
            profiles = take_sweep(pose, self.loaded, scanner, self.bus, self.mover, self.collector)
        except StreamBroke as broken:
            return self._leave_out(pose, str(broken), "look at the sensor, its cable and its network")
        if profiles.lost:
            self.bus.gap("profiles", f"pose {pose.number}: the scanner lost {profiles.lost} of its profiles", pose.number)
        if changed := self.facts.since_mark():
            return self._leave_out(pose, changed, "set it back as it was, and resume the run")
        if len(profiles) < LEAST_PROFILES:
            return self._leave_out(pose, f"the scanner sent {len(profiles)} profiles", "look at its trigger, exposure and field of view")
        measured: ArmAtPose = {"q": reached.q, "sensors": self._read_sensors(pose), "facts": self.facts.values}
        return self._done(pose, [FoundSpheres.of()], 0, reached, measured)

    def _leave_out(self, pose: PlannedPose, contradiction: str, remedy: str) -> bool:
        """False; names a pose whose exposures failed the checks, or whose devices were set up otherwise.

        Raises DeviceFault after several such poses in a row.
        """
        self.left_out.append(pose.number)
        self._in_a_row += 1
        self.last_reason = f", the last one because {contradiction}"
        self.bus.gap("pose", f"pose {pose.number} ({pose.step_name}): {contradiction}, pose left out", pose.number)
        if self._in_a_row >= self.options.poses_in_a_row:
            raise DeviceFault(f"{self._in_a_row} poses in a row were left out{self.last_reason}; {remedy}")
        return False

    def _stood(self, cycles: Mapping[str, np.ndarray], q: np.ndarray, pose: PlannedPose, left: int) -> bool:
        """Whether the arm stood at the pose during its exposures, q (n,) rad being the mean of what it reported.

        Raises SafetyStop if it did not and no attempt is left.
        """
        limit = self.options.standstill_tolerances * self.mover.limits.tolerance
        moved = np.ptp(cycles["q"], axis=0) if cycles else np.zeros(len(q))
        away = np.abs(q - pose.q)
        if np.all(moved <= limit) and np.all(away <= limit):
            return True
        if np.all(moved <= limit):
            text = f"the arm stood {self._worst(away, limit)} from pose {pose.number} during its exposures"
        else:
            text = (
                f"the arm moved by {self._worst(moved, limit)} during the exposures of pose {pose.number}{_by_leap(cycles, self.fastest)}"
            )
        if not left:
            raise SafetyStop(f"{text}, twice; its brakes or its controller do not hold it, so the run was ended")
        self.bus.message("warning", f"{text}; it is measured again")
        return False

    def _worst(self, off: np.ndarray, limit: np.ndarray | float) -> str:
        """The distance (n,) rad, mm, that exceeds its limit most, as people read it."""
        robot, axis = self.loaded.cell.robot, int(np.argmax(off / limit))
        return f"{robot.shown(off)[axis]:.3f}{robot.unit(axis)}"

    def _read_sensors(self, pose: PlannedPose) -> dict[str, float]:
        values: dict[str, float] = {}
        for number, (sensor, use) in enumerate(zip(self.devices.sensors, self.loaded.plan.sensors, strict=True), 1):
            try:
                values.update(read_sensor(sensor))
            except MbcacqError as error:
                if use.required:
                    raise
                names = ", ".join(f.name for f in sensor.describe().fields)
                self.bus.gap("sensor", f"sensor {number}: {error}; pose {pose.number} has no {names}", pose.number)
        return values


def _by_leap(cycles: Mapping[str, np.ndarray], fastest: np.ndarray) -> str:
    """A remark where joint angles changed faster than the axes can turn, fastest (n,) rad/s; else ''."""
    step_s, step = np.diff(cycles["time_s"]), np.abs(np.diff(cycles["q"], axis=0))
    leaps = ~np.all(step <= fastest * np.maximum(step_s, 0.0)[:, None], axis=1)
    return f" (in {leaps.sum()} cycles faster than its axes can turn, as damaged telegrams show it)" if leaps.any() else ""
