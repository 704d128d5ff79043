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

import numpy as np

from mbcacq import __version__
from mbcacq.acquisition.bus import EventBus, Subscriber
from mbcacq.acquisition.cell_devices import Overrides, create_devices
from mbcacq.acquisition.runner import Runner
from mbcacq.cell import Cell
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.plan import LoadedPlan, PlannedPose, Transit


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


def resume_folder(folder: Path, loaded: LoadedPlan) -> tuple[Path, frozenset[int], int]:
    """The folder of an interrupted run, the numbers of the poses it has, and how many recording parts it holds.

    Raises ConfigError where there is no run, or where it belongs to another plan.
    """
    journal, plan = folder / "journal.jsonl", folder / "plan.yaml"
    if not journal.exists() or not plan.exists():
        raise ConfigError(f"{folder} holds no run to resume (no journal.jsonl and plan.yaml); give the folder of the interrupted run")
    if plan.read_text(encoding="utf-8") != loaded.text:
        raise ConfigError(f"the plan was changed since {folder} was recorded; resume with {plan} or start a new run")
    from mbcacq.recording import poses_done

    return folder, poses_done(folder), len(list(folder.glob("run*.rrd")))


def solver_cell(loaded: LoadedPlan) -> Cell:
    """The cell as a solver may know it: planned station places are aims, not measurements, and are left out.

    So is the scanner's stated noise: it is that of one exposure, and what the mean of several has is estimated from the data.
    """
    stations = tuple(replace(s, T_base_station=None, sigma_mm=None) for s in loaded.cell.stations)
    return replace(loaded.cell, stations=stations, noise_mm=None)


@dataclass(frozen=True)
class Acquisition:
    """What to execute, and where it is written. parts: recording files the folder holds already (a resumed run writes a new one)."""

    loaded: LoadedPlan
    poses: Sequence[PlannedPose]
    paths: Sequence[Transit]
    way_home: Sequence[np.ndarray]
    folder: Path
    parts: int = 0

    def execute(
        self, overrides: Overrides | None = None, subscribers: Iterable[Subscriber] = (), *, live: bool = False,
        confirm: Callable[[np.ndarray], None] | None = None, done: frozenset[int] = frozenset(),
        told: Callable[[str], None] = lambda url: None,
    ) -> None:
        """Run the plan and record it. Raises what ended it early; what was measured until then is in the folder.

        live: serve the recording on 127.0.0.1 while it grows; ``told`` gets the address for the viewer.
        """
        from mbcacq.plan.route import check_start
        from mbcacq.recording import Journal, Recorder
        from mbcacq.recording.cell_yaml import cell_to_yaml
        from mbcacq.spheres import find_balls

        def gate(q: np.ndarray) -> None:
            check_start(self.loaded, q)
            if confirm is not None:
                confirm(q)

        (self.folder / "plan.yaml").write_text(self.loaded.text, encoding="utf-8")
        with closing(Recorder(self.folder, live=live, part=self.parts)) as recorder, closing(Journal(self.folder)) as journal:
            if recorder.live_url:
                told(recorder.live_url)
            Runner(
                self.loaded, self.poses, self.paths, self.way_home, create_devices(self.loaded, overrides),
                EventBus([recorder, journal, *subscribers]), find_balls, cell_to_yaml(solver_cell(self.loaded)), versions(),
                gate, done,
            ).run()


def evaluate(run: Path, limit_mm: float | None = None) -> dict:
    """Calibrate what a run recorded, verify it on the poses kept apart, write result.json, report.html and the residuals into its folder.

    A plan without phase 'position' (the artefact at several places) cannot determine the whole cell and is not blamed for that: what
    its poses leave open is held, and the standard deviations tell the rest.
    Returns the result as written, with 'files' naming all of them. limit_mm: the plan's limit of the sphere spacing error.
    """
    from mbcacq.calibration import Options, calibrate, verify
    from mbcacq.recording import load, log_result
    from mbcacq.report import write_report

    observations = load(run)
    calibration = calibrate(observations, Options(refuse="position" in observations.phase))
    verification = verify(observations, calibration, limit_mm=limit_mm)
    result = calibration.to_dict() | {"verification": verification.to_dict()}
    (run / "result.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    report = write_report(run, observations=observations, calibration=calibration, verification=verification)
    log_result(run, observations, calibration.state, calibration.preliminary)
    return result | {"files": {"recording": str(run / "run.rrd"), "result": str(run / "result.json"), "report": str(report)}}
