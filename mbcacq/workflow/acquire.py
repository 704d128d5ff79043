"""From a plan to a recording: the whole path is checked, the devices are opened, the runner's events are recorded."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbcacq.acquisition.cell_devices import Overrides, create_devices
from mbcacq.acquisition.event_bus import EventBus, Subscriber
from mbcacq.acquisition.runner import Pause, Runner
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.files.atomic_write import sync_folder
from mbcacq.model.cell import Cell
from mbcacq.model.json_text import fields_as_json
from mbcacq.plan import LoadedPlan, PlannedPose, Transit, path
from mbcacq.plan.motion_preview import Swept, refuse_unsafe, segments, swept
from mbcacq.plan.routing import check_start, path_home
from mbcacq.recording.datasets.cell_yaml import cell_to_yaml
from mbcacq.recording.run_folder.journal import Journal, recorded_facts
from mbcacq.recording.run_folder.latest import mark_latest
from mbcacq.recording.run_folder.recovery import WHOLE
from mbcacq.recording.run_folder.register import RunKind
from mbcacq.recording.run_folder.run_plan import keep_plan, plan_files_text
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import SphereOptions
from mbcacq.version import __version__
from mbcacq.workflow.change_watch import ChangeWatch
from mbcacq.workflow.resume import measured_balls, merge_parts

if TYPE_CHECKING:
    from mbcacq.recording.rrd.choice_panel import WeighedPoses
    from mbcacq.workflow.corrected_targets import CorrectedTargets


def versions() -> dict[str, str]:
    """Versions that decide a result, by name."""
    named = {name: version(name) for name in ("numpy", "scipy", "rerun-sdk", "ruckig")}
    return {"mbcacq": __version__, "python": platform.python_version(), **named}


def named_run_folder(out: Path | None, name: str) -> Path:
    """The folder of a new run: ``out`` if given (must not hold a run yet), else runs/TIME_NAME. It is not made yet."""
    folder = out or Path("runs") / f"{datetime.now():%Y-%m-%dT%H-%M-%S}_{re.sub(r'[^A-Za-z0-9_-]+', '-', name)}"
    if os.path.exists(folder / "run.rrd"):  # False where that cannot be known: making it says why
        raise ConfigError(f"{folder} already holds a run; give another --out, or go on with it by --resume {folder}")
    return folder


def new_run_folder(out: Path | None, name: str) -> Path:
    """Create the folder of a run, which ``named_run_folder`` names."""
    folder = named_run_folder(out, name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sync_folder(folder.parent)
    except OSError as error:
        raise RecordingError(f"cannot create the run folder {folder}: {error.strerror}; give another --out") from error
    return folder


def plan_acquisition(loaded: LoadedPlan, poses: Sequence[PlannedPose], done: frozenset[int], part: int, cell: str) -> Acquisition:
    """The whole path of the poses that remain, checked from home to home before anything is opened.

    Raises ConfigError or SafetyStop where a limit, the workspace or a clearance would be broken anywhere on it.
    """
    last = next(p for p in reversed(poses) if p.number not in done)
    acquisition = Acquisition(
        loaded=loaded,
        poses=poses,
        paths=path(loaded, poses, done),
        path_home=path_home(loaded, last),
        folder=Path(),
        part=part,
        done=done,
        cell=cell,
    )
    refuse_unsafe(loaded, list(segments(loaded, poses, acquisition.paths, acquisition.path_home, done)))
    return acquisition


def solver_cell(loaded: LoadedPlan) -> Cell:
    """The cell as a solver may know it: planned placements of stations are aims, not measurements, and are removed.

    So is the scanner's stated noise: it is that of one exposure, and what the mean of several has is estimated from the data.
    """
    stations = tuple(replace(s, T_base_station=None, sigma_mm=None) for s in loaded.cell.stations)
    return replace(loaded.cell, stations=stations, noise_mm=None)


@contextmanager
def recorded(
    folder: Path,
    loaded: LoadedPlan,
    plan_files: str,
    subscribers: Iterable[Subscriber],
    *,
    part: int = 0,
    message: Callable[[str], None] = lambda sentence: None,
    **shown: Any,
) -> Iterator[EventBus]:
    """The bus of a run whose events are recorded in its folder, with the plan. shown: as ``Recorder`` takes it. The parts of a resumed run
    become one recording at its end."""
    from mbcacq.recording.rrd.writer import Recorder

    (folder / WHOLE).unlink(missing_ok=True)  # of an earlier resume; it would lack what comes now
    keep_plan(folder, loaded.text, plan_files)
    recorder = Recorder(folder, part=part, all_points=loaded.plan.scanner.keep_clouds == "all", **shown)
    with closing(recorder), Journal(folder) as journal:
        if recorder.live_url:
            message(f"watch it live: rerun {recorder.live_url}")
        yield EventBus([recorder, journal, *subscribers])
    if part:
        merge_parts(folder, message)


@dataclass(kw_only=True)
class Acquisition:
    """A checked path to execute, and the folder of its recording.

    Attributes
    ----------
    part : int
        Number of the recording (0, but for a resumed run).
    done : frozenset[int]
        Numbers of the poses to pass over.
    cell : str
        The cell that is driven, in words, so that a resumed run stays with it.
    simulated : bool
        Whether the cell is a fake one.
    corrected : CorrectedTargets or None
        The targets, where a calibrated arm steers.
    weighed : WeighedPoses or None
        Knowledge of an investigation before these poses.
    kind : RunKind
        What is recorded.
    """

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    paths: Sequence[Transit]
    path_home: Sequence[np.ndarray]
    folder: Path
    part: int = 0
    done: frozenset[int] = frozenset()
    cell: str = ""
    simulated: bool = False
    corrected: CorrectedTargets | None = None
    weighed: WeighedPoses | None = None
    kind: RunKind = RunKind.RUN

    def sweep(self) -> Swept:
        """The box that the arm will sweep, and its largest speed."""
        return swept(self.loaded, list(segments(self.loaded, self.poses, self.paths, self.path_home, self.done)))

    def execute(
        self,
        overrides: Overrides | None = None,
        subscribers: Iterable[Subscriber] = (),
        *,
        live: bool = False,
        message: Callable[[str], None] = lambda sentence: None,
        pause: Pause | None = None,
    ) -> None:
        """Run the plan and record it. Raises what ended it early; what was measured until then is in the folder.

        live: serve the recording on 127.0.0.1 while it grows. message: gets sentences for people, such as the address for the viewer.
        pause: asked before each pose.
        """

        def gate(q: np.ndarray) -> None:
            mark_latest(self.folder, self.kind)  # not before every device answered
            if self.loaded.plan.robot.follow is None:  # else nothing is moved from there
                check_start(self.loaded, q)

        known = measured_balls(self.folder, self.loaded, self.done) if self.done else {}
        steered = None if self.corrected is None else fields_as_json(self.corrected)
        plan_files = plan_files_text(self.loaded.files, self.cell, self.kind, self.loaded.path, steered, self.loaded.grown_from)
        shown = {"live": live, "weighed": self.weighed}
        with recorded(self.folder, self.loaded, plan_files, subscribers, part=self.part, message=message, **shown) as bus:
            bus.subscribe(ChangeWatch(solver_cell(self.loaded), bus))
            Runner(
                loaded=self.loaded,
                poses=self.poses,
                paths=self.paths,
                path_home=self.path_home,
                devices=create_devices(self.loaded, overrides),
                bus=bus,
                find_balls=partial(find_spheres, options=SphereOptions.for_noise(self.loaded.plan.scanner.noise_mm)),
                cell_yaml=cell_to_yaml(replace(solver_cell(self.loaded), simulated=self.simulated)),
                versions=versions(),
                confirm=gate,
                done=self.done,
                pause=pause,
                known=known,
                simulated=self.simulated,
                plan_files=plan_files,
                facts=recorded_facts(self.folder) if self.done else {},
            ).run()
