"""One pose measured: the arm moved there, exposures taken, balls found, sensors read, and all of it checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.cell_devices import CellDevices
from mbcacq.acquisition.cycle_collector import CycleCollector
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.expected_view import Centres, mean_centres, predicted_centres
from mbcacq.acquisition.mover import Mover
from mbcacq.acquisition.placement import PlacementCheck
from mbcacq.acquisition.reconnect_policy import ReconnectingScanner, read_sensor
from mbcacq.devices import DeviceFault, MbcacqError, SafetyStop
from mbcacq.model.cell import Artefact
from mbcacq.plan import LoadedPlan, PlannedPose


class BallFinder(Protocol):
    """Extracts ball centres from a scan."""

    def __call__(self, points: np.ndarray, artefact: Artefact, *, expected: Sequence[int], predicted: np.ndarray) -> Centres:
        """The balls found. points: (N, 3) mm; expected: (k,) ids; predicted: (k, 3) mm, all in the scanner frame."""
        ...


class Misplaced(DeviceFault):
    """The artefact does not stand where the plan says."""


@dataclass
class PoseMeasurement:
    """Measures poses one by one, with the devices of a run that is going on."""

    loaded: LoadedPlan
    devices: CellDevices
    bus: EventBus
    find_balls: BallFinder
    scanner: ReconnectingScanner
    placement: PlacementCheck
    mover: Mover
    collector: CycleCollector

    def measure(self, pose: PlannedPose, first: bool = False) -> bool:
        """Move to a pose and measure it, ``first`` at its station. Returns whether enough balls were found.

        The pose is measured a second time where the arm moved during the exposures. Raises Misplaced, SafetyStop where the arm moved
        both times, and what the devices raise.
        """
        about = (pose.number, pose.station, pose.phase, pose.step_name)
        for left in (1, 0):
            self.bus.state("moving")
            reached = self.mover.go(pose.q)
            self.bus.emit(events.PoseReached, *about, reached.q, self.mover.direction, reached.time_s)
            self.bus.state("scanning")
            self.collector.mark()
            found = self._exposures(pose, reached.q, first)
            now = self.devices.robot.state()  # raises what stopped the arm meanwhile
            cycles = self.collector.since_mark()
            if self._stood(cycles, pose, left):
                break
        q = cycles["q"].mean(axis=0) if cycles else now.q
        current = cycles["current_percent"].mean(axis=0) if "current_percent" in cycles else None
        sensors = self._read_sensors(pose)
        mean = mean_centres(found)
        if len(mean.ball) < min(self.loaded.plan.accept.min_balls, len(pose.balls)):
            few = f"{len(mean.ball)} of {len(pose.balls)} balls found, pose left out"
            self.bus.gap("pose", f"pose {pose.number} ({pose.step_name}): {few}", pose.number)
            return False
        self.bus.emit(
            events.PoseDone,
            *about,
            q,
            self.mover.direction.copy(),
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

    def _exposures(self, pose: PlannedPose, q: np.ndarray, first: bool) -> list[Centres]:
        found = [self._expose(pose, 0)]
        if first:
            self._check_placement(pose, q, found[0])
        return found + [self._expose(pose, k) for k in range(1, pose.exposures)]

    def _expose(self, pose: PlannedPose, exposure: int) -> Centres:
        scan = self.scanner.capture(self.loaded.plan.scanner.exposure_us)
        self.bus.emit(events.ScanTaken, pose.number, exposure, scan)
        if scan.health:
            self.bus.emit(events.HealthReceived, "scanner", dict(scan.health))
        for warning in scan.warnings:
            self.bus.message("warning", f"pose {pose.number}: {warning}")
        artefact = self.loaded.cell.artefact(pose.artefact)
        predicted = predicted_centres(self.loaded.cell, pose)
        found = self.find_balls(scan.points, artefact, expected=pose.balls, predicted=predicted)
        self.bus.emit(events.CentresFound, pose.number, exposure, found.ball, found.xyz, found.n_points, found.rms_mm)
        return found

    def _check_placement(self, pose: PlannedPose, q: np.ndarray, found: Centres) -> None:
        if len(found.ball) == 0 and not self.devices.asks_a_person:
            return  # nobody to ask: the pose is left out, and more of them end the run
        if sentence := self.placement.fault(pose, q, found.ball, found.xyz):
            raise Misplaced(sentence)

    def _stood(self, cycles: Mapping[str, np.ndarray], pose: PlannedPose, left: int) -> bool:
        """Whether the arm stood during the exposures of a pose. Raises SafetyStop if it did not and no attempt is left."""
        moved = float(np.max(np.ptp(cycles["q"], axis=0))) if cycles else 0.0
        if moved <= 2 * self.mover.limits.tolerance:
            return True
        text = f"the arm moved by {np.degrees(moved):.3f} deg during the exposures of pose {pose.number}"
        if not left:
            raise SafetyStop(f"{text}, twice; its brakes or its controller do not hold it, so the run was ended")
        self.bus.message("warning", f"{text}; it is measured again")
        return False

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
