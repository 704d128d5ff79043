"""The events of a run that already happened: clouds from files, judged as a run judges its exposures. Nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.gate_options import GateOptions
from mbcacq.acquisition.gated_exposures import BallFinder, GatedExposures, Misplaced
from mbcacq.acquisition.placement import PlacementCheck
from mbcacq.acquisition.pose_observation import ArmAtPose, emit_observation
from mbcacq.devices import DeviceFault, MbcacqError, Scan
from mbcacq.plan import LoadedPlan, PlannedPose


@dataclass(frozen=True)
class CollectedPose:
    """What there is of one pose. q: (n,) rad as logged, or as planned; direction: (n,) of rotation on the way there; clouds: of its
    exposures, in order; time_s: of the first of them."""

    pose: PlannedPose
    q: np.ndarray
    direction: np.ndarray
    clouds: tuple[Path, ...]
    time_s: float = 0.0


class _Files:
    """Hands out the clouds of one pose; the last one again where one more is asked for."""

    def __init__(self, read: Callable[[Path], np.ndarray]) -> None:
        self._read, self._left, self._number = read, list[Path](), 0

    def load(self, clouds: Sequence[Path]) -> None:
        self._left = list(clouds)

    def capture(self, exposure_us: float | None) -> Scan:
        path = self._left.pop(0) if len(self._left) > 1 else self._left[0]
        self._number += 1
        return Scan(self._read(path).astype(np.float32), frame=self._number)


@dataclass
class CollectedRun:
    """poses: those with clouds, in running order. notes: sentences on what was found when the clouds were paired: (number of the pose or
    None, text). read: points (N, 3) mm of a file. The others: as in ``mbcacq.acquisition.runner.Runner``."""

    loaded: LoadedPlan
    n_poses: int
    poses: Sequence[CollectedPose]
    notes: Sequence[tuple[int | None, str]]
    bus: EventBus
    read: Callable[[Path], np.ndarray]
    find_balls: BallFinder
    cell_yaml: str
    versions: dict[str, str]
    simulated: bool = False
    plan_files: str = ""
    known: Mapping[str, Mapping[int, np.ndarray]] = field(default_factory=dict)

    def run(self) -> int:
        """Emit everything and return how many poses were accepted. Emits RunStopped in every case, then raises what ended it."""
        plan = self.loaded.plan
        now = datetime.now(UTC).isoformat(timespec="seconds")
        about = (plan.name, now, self.loaded.text, self.cell_yaml, self.n_poses, self.versions, {}, "", self.simulated, self.plan_files)
        self.bus.emit(events.RunStarted, *about)
        try:
            for number, text in self.notes:
                self.bus.gap("pose" if number is not None else "exposure", text, number)
            accepted = self._measure_all()
        except BaseException as error:
            reason = str(error) if isinstance(error, MbcacqError) else f"unexpected {type(error).__name__}: {error}"
            self.bus.emit(events.RunStopped, "fail", reason)
            raise
        self.bus.emit(events.RunStopped, "success", f"{accepted} of {self.n_poses} poses collected from files; nothing was moved")
        return accepted

    def _measure_all(self) -> int:
        files = _Files(self.read)
        placement = PlacementCheck(self.loaded.cell, self.loaded.plan.station_tolerance_mm, self.known)
        gates = replace(GateOptions(), repeated_exposures=0)
        exposures = GatedExposures(self.loaded, self.bus, files, self.find_balls, placement, gates)  # type: ignore[arg-type]
        station, step, accepted = None, None, 0
        for here in self.poses:
            pose = here.pose
            if pose.step != step:
                step = pose.step
                self.bus.emit(events.StepStarted, step, pose.step_name, sum(p.pose.step == step for p in self.poses))
            first = pose.station != station
            if first:
                self.bus.emit(events.StationReached, pose.station, pose.artefact)
            files.load(here.clouds)
            if self._measure(here, exposures, first):
                accepted += 1
                station = pose.station  # until one is accepted, the next is still the first there
        return accepted

    def _measure(self, here: CollectedPose, exposures: GatedExposures, first: bool) -> bool:
        pose = replace(here.pose, q=here.q, exposures=len(here.clouds))
        about = (pose.number, pose.station, pose.phase, pose.step_name)
        self.bus.emit(events.PoseReached, *about, here.q, here.direction, here.time_s)
        try:
            found, contradiction = exposures.take(pose, here.q, first)
        except (Misplaced, DeviceFault) as error:
            found, contradiction = [], str(error)
        names = ", ".join(path.name for path in here.clouds)
        if contradiction:
            self.bus.gap("pose", f"pose {pose.number} ({names}): {contradiction}, pose left out", pose.number)
            return False
        arm: ArmAtPose = {"q": here.q, "direction": here.direction, "robot_time_s": here.time_s}
        return emit_observation(self.bus, pose, found, self.loaded.plan.accept.min_balls, names, arm)
