"""From a plan to a calibrated cell: the rooms of the house in their one direction, for the command line and for programs."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbcacq import __version__
from mbcacq.acquisition.cell_devices import Overrides, create_devices
from mbcacq.acquisition.event_bus import EventBus, Subscriber
from mbcacq.acquisition.runner import Runner
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.model.cell import Cell
from mbcacq.plan import LoadedPlan, PlannedPose, Transit

if TYPE_CHECKING:
    from mbcacq.acquisition.runner import Pause
    from mbcacq.plan.motion_preview import Swept
    from mbcacq.recording.run_folder.progress import Progress


def versions() -> dict[str, str]:
    """Versions that decide a result, by name."""
    named = {name: version(name) for name in ("numpy", "scipy", "rerun-sdk", "ruckig")}
    return {"mbcacq": __version__, "python": platform.python_version(), **named}


def new_run_folder(out: Path | None, name: str) -> Path:
    """Create the folder of a run: ``out`` if given (must not hold a run yet), else runs/TIME_NAME."""
    folder = out or Path("runs") / f"{datetime.now():%Y-%m-%dT%H-%M-%S}_{re.sub(r'[^A-Za-z0-9_-]+', '-', name)}"
    if (folder / "run.rrd").exists():
        raise ConfigError(f"{folder} already holds a run; give another --out, or go on with it by --resume {folder}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(f"cannot create the run folder {folder}: {error.strerror}; give another --out") from error
    return folder


def fresh() -> Progress:
    """Of a run that begins."""
    from mbcacq.recording.run_folder.progress import Progress

    return Progress(frozenset(), 0, {})


def resume_folder(folder: Path, loaded: LoadedPlan, cell: str) -> Progress:
    """What an interrupted run has measured, its torn recordings made readable.

    Raises ConfigError where there is no run, or where it belongs to another plan or another ``cell``.
    """
    from mbcacq.recording import repair_and_read_progress
    from mbcacq.recording.run_folder.run_plan import refuse_change

    refuse_change(folder, loaded.text, loaded.files, cell)
    return repair_and_read_progress(folder)


def without_partial_stations(poses: Sequence[PlannedPose], before: Progress) -> frozenset[int]:
    """The poses done, but for those at stations that have others left: their artefact was touched meanwhile."""
    left = {p.station for p in poses if p.number not in before.done}
    return before.done - {number for station in left for number in before.stations.get(station, ())}


def plan_run(loaded: LoadedPlan, poses: Sequence[PlannedPose], done: frozenset[int], part: int, cell: str) -> Acquisition:
    """The whole path of what is left to do, looked at from home to home before anything is opened.

    Raises ConfigError or SafetyStop where a limit, the workspace or a clearance would be broken anywhere on it.
    """
    from mbcacq.plan import path
    from mbcacq.plan.motion_preview import refuse_unsafe, segments
    from mbcacq.plan.routing import path_home

    last = next(p for p in reversed(poses) if p.number not in done)
    acquisition = Acquisition(loaded, poses, path(loaded, poses, done), path_home(loaded, last), Path(), part, done, cell)
    refuse_unsafe(loaded, list(segments(loaded, poses, acquisition.paths, acquisition.path_home, done)))
    return acquisition


def solver_cell(loaded: LoadedPlan) -> Cell:
    """The cell as a solver may know it: planned station places are aims, not measurements, and are left out.

    So is the scanner's stated noise: it is that of one exposure, and what the mean of several has is estimated from the data.
    """
    stations = tuple(replace(s, T_base_station=None, sigma_mm=None) for s in loaded.cell.stations)
    return replace(loaded.cell, stations=stations, noise_mm=None)


@dataclass
class Acquisition:
    """What to execute, and where it is written. part: number of the recording (0, but for a resumed run); done: numbers of the poses to
    pass over; cell: which cell is driven, in words, so that a resumed run stays with it."""

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    paths: Sequence[Transit]
    path_home: Sequence[np.ndarray]
    folder: Path
    part: int = 0
    done: frozenset[int] = frozenset()
    cell: str = ""

    def sweep(self) -> Swept:
        """What the arm will sweep, and how fast."""
        from mbcacq.plan.motion_preview import segments, swept

        return swept(self.loaded, list(segments(self.loaded, self.poses, self.paths, self.path_home, self.done)))

    def execute(
        self,
        overrides: Overrides | None = None,
        subscribers: Iterable[Subscriber] = (),
        *,
        live: bool = False,
        confirm: Callable[[np.ndarray], None] | None = None,
        told: Callable[[str], None] = lambda url: None,
        pause: Pause | None = None,
    ) -> str:
        """Run the plan and record it. Raises what ended it early; what was measured until then is in the folder. Returns '', or a sentence
        where all is measured and the parts of a resumed run could not be merged.

        live: serve the recording on 127.0.0.1 while it grows; ``told`` gets the address for the viewer. pause: asked before each pose.
        """
        from mbcacq.plan.routing import check_start
        from mbcacq.recording import Journal, Recorder
        from mbcacq.recording.datasets.cell_yaml import cell_to_yaml
        from mbcacq.recording.run_folder.recovery import WHOLE
        from mbcacq.recording.run_folder.run_plan import keep_plan
        from mbcacq.spheres import find_spheres

        def gate(q: np.ndarray) -> None:
            check_start(self.loaded, q)
            if confirm is not None:
                confirm(q)

        (self.folder / WHOLE).unlink(missing_ok=True)  # of an earlier resume; it would lack what comes now
        known = places_seen(self.folder, self.loaded, self.done) if self.done else {}
        keep_plan(self.folder, self.loaded.text, self.loaded.files, self.cell)
        with closing(Recorder(self.folder, live=live, part=self.part)) as recorder, closing(Journal(self.folder)) as journal:
            if recorder.live_url:
                told(recorder.live_url)
            Runner(
                self.loaded,
                self.poses,
                self.paths,
                self.path_home,
                create_devices(self.loaded, overrides),
                EventBus([recorder, journal, *subscribers]),
                find_spheres,
                cell_to_yaml(solver_cell(self.loaded)),
                versions(),
                gate,
                self.done,
                pause,
                known,
            ).run()
        return merge(self.folder) if self.part else ""


def places_seen(folder: Path, loaded: LoadedPlan, done: frozenset[int]) -> dict[str, dict[int, np.ndarray]]:
    """Where the balls stood at the poses that count as done: station -> ball id -> (3,) mm, mean over its poses, base frame of the nominal
    arm."""
    from mbcacq.geometry import se3
    from mbcacq.recording import load_observations

    obs = load_observations(folder)
    T = obs.cell.robot.chain.flange(obs.q) @ loaded.cell.T_flange_scanner
    place = se3.apply(T[obs.pose], obs.xyz)
    seen: dict[str, dict[int, list[np.ndarray]]] = {}
    for row, (pose, ball) in enumerate(zip(obs.pose, obs.ball, strict=True)):
        if int(obs.pose_id[pose]) in done:
            station = obs.cell.stations[obs.station[pose]].id
            seen.setdefault(station, {}).setdefault(obs.cell.ball_ids[ball], []).append(place[row])
    return {station: {ball: np.mean(points, axis=0) for ball, points in balls.items()} for station, balls in seen.items()}


def merge(folder: Path) -> str:
    """The parts of a resumed run as one recording, whole.rrd, beside them. Returns '', or a sentence where the disk does not take it."""
    from mbcacq.recording import recover

    try:
        recover(folder)
    except RecordingError as error:
        return f"the parts of {folder} were not merged into one recording: {error}; later: mbcacq recover {folder}"
    return ""


def evaluate(run: Path, limit_mm: float | None = None) -> dict:
    """Calibrate what a run recorded, verify it on the poses kept apart, write result.json, report.html and the residuals into its folder.

    A plan without phase 'position' (the artefact at several places) cannot determine the whole cell and is not blamed for that: what
    its poses leave open is held, and the standard deviations tell the rest.
    Returns the result as written, with 'files' naming all of them. limit_mm: the plan's limit of the sphere spacing error.
    """
    from mbcacq.calibration import CalibrationOptions, calibrate, verify
    from mbcacq.calibration.accuracy_map import accuracy_map
    from mbcacq.recording import find_gaps, load_observations, log_result
    from mbcacq.recording.datasets.csvfile import write_text
    from mbcacq.recording.run_folder.recovery import WHOLE
    from mbcacq.report import read_run_info, report_from_result

    observations = load_observations(run)
    calibration = calibrate(observations, CalibrationOptions(refuse="position" in observations.phase))
    result = calibration.to_dict() | {
        "verification": verify(observations, calibration, limit_mm=limit_mm).to_dict(),
        "accuracy_map": accuracy_map(calibration).to_dict(),
        "gaps": find_gaps(run),
    }
    write_text(run / "result.json", json.dumps(result, indent=1))
    report = report_from_result(result, path=run / "report.html", observations=observations, run_info=read_run_info(run))
    log_result(run, observations, calibration.state, calibration.preliminary)
    recording = run / WHOLE if (run / WHOLE).exists() else run / "run.rrd"
    return result | {"files": {"recording": str(recording), "result": str(run / "result.json"), "report": str(report)}}
