"""Recordings: written during a run, read back, recovered after a crash, exchanged as observation sets."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbcacq.model.observations import Observations

_LAZY = {
    "Journal": "run_folder.journal",
    "Recorder": "rrd.writer",
    "Recording": "rrd.reader",
    "Trajectory": "datasets.trajectory_set",
    "find_gaps": "run_folder.gaps",
    "log_result": "rrd.result_recording",
    "poses_done": "run_folder.progress",
    "read_observation_set": "datasets.observation_set",
    "read_trajectory_set": "datasets.trajectory_set",
    "recover": "run_folder.recovery",
    "take_stock": "run_folder.progress",
    "write_diagnosis": "rrd.diagnosis_recording",
    "write_observation_set": "datasets.observation_set",
}
__all__ = ["ACCEPTED", "load", *_LAZY]

ACCEPTED = "a run folder (with run.rrd), a recording (.rrd), or an observation-set folder (cell.yaml, poses.csv, centres.csv)"


def load(path: Path | str) -> Observations:
    """The observations in a run folder, a .rrd file or an observation-set folder.

    Raises ConfigError if it is none of these or its content is wrong, RecordingError if a recording is torn.
    """
    from mbcacq.errors import ConfigError

    path = Path(path)
    if not path.exists():
        raise ConfigError(f"{path} does not exist; give {ACCEPTED}")
    if path.is_dir() and (path / "trajectory.csv").exists() and not (path / "poses.csv").exists():
        raise ConfigError(f"{path} is a trajectory set, a recording in time; only mbcacq diagnose takes it")
    if path.is_dir() and (path / "cell.yaml").exists():
        from mbcacq.recording.datasets.observation_set import read_observation_set

        return read_observation_set(path)
    if path.suffix == ".rrd" or (path.is_dir() and any(path.glob("run*.rrd"))):
        from mbcacq.recording.rrd.reader import read_observations

        return read_observations(path)
    raise ConfigError(f"{path} is not a recording or an observation set; give {ACCEPTED}")


def __getattr__(name: str):
    """The room's classes and functions by name, imported only when asked for: rerun takes a quarter of a second."""
    if name in _LAZY:
        return getattr(importlib.import_module(f"mbcacq.recording.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
