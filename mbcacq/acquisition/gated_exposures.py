"""The exposures of one pose: each is judged as it comes, and taken again if it contradicts the plan or the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import chain
from typing import Protocol

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.expected_view import mean_centres, predicted_centres
from mbcacq.acquisition.exposure_agreement import ExposureAgreement
from mbcacq.acquisition.gate_options import GateOptions
from mbcacq.acquisition.placement import PlacementCheck
from mbcacq.acquisition.reconnect_policy import ReconnectingScanner
from mbcacq.acquisition.view_prediction import ViewPrediction
from mbcacq.devices import DeviceFault
from mbcacq.devices.protocols import Scan
from mbcacq.model.cell import Artefact
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.field_of_view import margin
from mbcacq.spheres.found import FoundSpheres


class BallFinder(Protocol):
    """Extracts ball centres from a scan."""

    def __call__(self, points: np.ndarray, artefact: Artefact, *, expected: Sequence[int], predicted: np.ndarray) -> FoundSpheres:
        """The balls found. points: (N, 3) mm; expected: (k,) ids; predicted: (k, 3) mm, all in the scanner frame."""
        ...


class Misplaced(DeviceFault):
    """The artefact does not stand where the plan says."""


@dataclass
class GatedExposures:
    """Takes the exposures of the poses of a run and judges them. The criteria are the field of view, the prediction from the station's
    earlier poses and the nominal arm, and the other exposures of the pose."""

    loaded: LoadedPlan
    bus: EventBus
    scanner: ReconnectingScanner
    find_balls: BallFinder
    placement: PlacementCheck
    options: GateOptions = GateOptions()
    asks_a_person: bool = False
    _agreement: ExposureAgreement = field(init=False)
    _prediction: ViewPrediction = field(init=False)

    def __post_init__(self) -> None:
        plan = self.loaded.plan
        self._agreement = ExposureAgreement(plan.scanner.noise_mm, self.options)
        self._prediction = ViewPrediction(self.loaded.cell, plan.station_tolerance_mm, self.options)

    def take(self, pose: PlannedPose, q: np.ndarray, first: bool) -> tuple[list[FoundSpheres], str]:
        """The exposures of a pose that agree, and ''; or, if the pose is to be left out, what they contradict, as a clause.

        q: (n,) rad as reached; ``first`` at its station. Raises Misplaced, and what the scanner raises.
        """
        taken: list[FoundSpheres] = []
        contradiction, number = "", 0
        if first:
            self._prediction.new_station()
        if self.loaded.cell.artefact(pose.artefact).is_part:
            return self._scans_of_part(pose)
        if first:
            taken, number = self._placed(pose, q)
        again = range(max(number, pose.exposures), pose.exposures + self.options.repeated_exposures)
        exposures = chain(self._needed(pose, range(number, pose.exposures)), (self._expose(pose, k) for k in again))
        while not self._complete(pose, taken) and (found := next(exposures, None)) is not None:
            if why := self._contradiction(pose, found, first):
                contradiction = why
                self.bus.gap("exposure", f"pose {pose.number}: {why}; the exposure was left out", pose.number)
            else:
                taken.append(found)
        kept = self._complete(pose, taken)
        if not kept:
            return [], contradiction or self._difference(taken)
        if len(kept) < len(taken):
            self._name_left_out(pose, taken, kept)
        found = [taken[k] for k in kept]
        self._agreement.learn(found)
        mean = mean_centres(found)
        self._prediction.learn(pose, mean.ball, mean.xyz)
        return found, ""

    def _scans_of_part(self, pose: PlannedPose) -> tuple[list[FoundSpheres], str]:
        """Exposures of a surface, which have no balls and are judged when they are merged."""
        for exposure in range(pose.exposures):
            scan = self._capture()
            self._report_scan(pose, exposure, scan)
            if not len(scan.points):
                return [], "its scan shows no point of the part"
        return [FoundSpheres.of() for _ in range(pose.exposures)], ""

    def _placed(self, pose: PlannedPose, q: np.ndarray) -> tuple[list[FoundSpheres], int]:
        """The first exposure that shows the artefact of a station in its place, and how many were taken. Raises Misplaced."""
        found = self._expose(pose, 0)
        if not (sentence := self._misplacement(pose, q, found)):
            return [found], 1
        again = self._expose(pose, 1)
        if self._misplacement(pose, q, again):
            raise Misplaced(sentence)
        self.bus.gap("exposure", f"pose {pose.number}: {sentence}, but not in a second exposure; the first was left out", pose.number)
        return [again], 2

    def _misplacement(self, pose: PlannedPose, q: np.ndarray, found: FoundSpheres) -> str:
        if len(found.ball) == 0 and not self.asks_a_person:
            return ""  # nobody to ask: the pose is left out, and more of them end the run
        return self.placement.fault(pose, q, found.ball, found.xyz)

    def _expose(self, pose: PlannedPose, exposure: int) -> FoundSpheres:
        scan = self._capture()
        self._report_scan(pose, exposure, scan)
        return self._report_centres(pose, exposure, self._balls(pose, scan))

    def _needed(self, pose: PlannedPose, exposures: Sequence[int]) -> Iterator[FoundSpheres]:
        """Exposures that are taken whatever they show: the balls of one are looked for while the scanner takes the next."""
        pending: tuple[int, Future[FoundSpheres]] | None = None
        with ThreadPoolExecutor(1) as worker:
            for exposure in exposures:
                try:
                    scan = self._capture()
                finally:  # what was taken before is not lost where the scanner fails
                    found = None if pending is None else self._report_centres(pose, pending[0], pending[1].result())
                if found is not None:
                    yield found
                self._report_scan(pose, exposure, scan)
                pending = exposure, worker.submit(self._balls, pose, scan)
            if pending is not None:
                yield self._report_centres(pose, pending[0], pending[1].result())

    def _capture(self) -> Scan:
        return self.scanner.capture(self.loaded.plan.scanner.exposure_us)

    def _balls(self, pose: PlannedPose, scan: Scan) -> FoundSpheres:
        cell = self.loaded.cell
        return self.find_balls(scan.points, cell.artefact(pose.artefact), expected=pose.balls, predicted=predicted_centres(cell, pose))

    def _report_scan(self, pose: PlannedPose, exposure: int, scan: Scan) -> None:
        self.bus.emit(events.ScanTaken, pose.number, exposure, scan)
        if scan.health:
            self.bus.emit(events.HealthReceived, "scanner", dict(scan.health))
        for warning in scan.warnings:
            self.bus.message("warning", f"pose {pose.number}: {warning}")

    def _report_centres(self, pose: PlannedPose, exposure: int, found: FoundSpheres) -> FoundSpheres:
        self.bus.emit(events.CentresFound, pose.number, exposure, found.ball, found.xyz, found.n_points, found.rms_mm)
        return found

    def _contradiction(self, pose: PlannedPose, found: FoundSpheres, first: bool) -> str:
        """What one exposure contradicts, as a clause, or ''."""
        plan = self.loaded.plan
        if not np.all(np.isfinite(found.xyz)):
            return "a ball centre is no finite number"
        if len(found.ball) == 0:
            return ""
        aimed = margin(plan.scanner.field_of_view, predicted_centres(self.loaded.cell, pose)).min(initial=0.0)
        inside = margin(plan.scanner.field_of_view, found.xyz)
        if inside.min() < aimed - plan.station_tolerance_mm:
            worst = int(np.argmin(inside))
            return f"ball {found.ball[worst]} appears {-inside[worst]:.0f} mm outside the scanner's field of view"
        if first:
            return ""  # what it would be compared with is not known yet
        sigmas, away = self._prediction.deviation(pose, found.ball, found.xyz)
        if sigmas > self.options.prediction_sigmas:
            return f"its balls appear {away:.1f} mm from where the earlier poses at station '{pose.station}' put them"
        return ""

    def _complete(self, pose: PlannedPose, taken: list[FoundSpheres]) -> list[int]:
        """Indices of the exposures that agree, as soon as they are enough and the majority; else none."""
        agreeing = self._agreement.majority(taken) or []
        return agreeing if len(agreeing) >= pose.exposures else []

    def _difference(self, taken: list[FoundSpheres]) -> str:
        distance, ball = self._agreement.largest_difference(taken)
        return f"its exposures differ by {distance:.2f} mm at ball {ball}"

    def _name_left_out(self, pose: PlannedPose, taken: list[FoundSpheres], kept: list[int]) -> None:
        out = sorted(set(range(len(taken))) - set(kept))
        text = f"pose {pose.number}: {self._difference(taken)}; {len(out)} of {len(taken)} exposures were left out"
        if max(out) < min(kept):  # one place before, another one after
            text += "; if the artefact was touched then, its station is no longer one place: resume with --again"
        self.bus.gap("exposure", text, pose.number)
