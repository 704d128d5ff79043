"""Recordings: written during a run, read back, recovered after a crash, exchanged as observation sets and trajectory sets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import finish_set

if TYPE_CHECKING:
    from mbcacq.model.observations import Observations
    from mbcacq.model.trajectory import Trajectory
    from mbcacq.recording.rrd.reader import Recording as Recording


ACCEPTED = (
    "a run folder (with run.rrd), a recording (.rrd), or an observation-set folder (cell.yaml, poses.csv, centres.csv), "
    "or one table (.csv) of poses of the flange and the target"
)


def load_observations(path: Path | str) -> Observations:
    """The observations in a run folder, a recording (.rrd) or an observation set (a folder with cell.yaml, poses.csv, centres.csv).

    Parameters
    ----------
    path
        The folder or file.

    Returns
    -------
    Observations
        P poses of an n-axis arm: ``q`` (P, n) rad, ``station`` (P,). M measured centres: ``pose`` (M,), ``ball`` (M,), ``xyz`` (M, 3) mm
        in the scanner frame. The cell says to what the joint angles are rounded.

    Raises
    ------
    ConfigError
        The content has a fault; the message names file, line and column.
    RecordingError
        The recording is torn.
    """
    from mbcacq.model.joint_resolution import with_joint_step

    return with_joint_step(_load_observations(Path(path)))


def _load_observations(path: Path) -> Observations:
    from mbcacq.recording.run_folder.latest import refuse_plan

    if not path.exists():
        raise ConfigError(f"{path} does not exist; give {ACCEPTED}")
    refuse_plan(path)
    if path.is_dir():
        finish_set(path)
    if path.is_dir() and (path / "trajectory.csv").exists() and not (path / "poses.csv").exists():
        raise ConfigError(f"{path} is a trajectory set, a recording in time; only mbcacq diagnose takes it")
    if path.is_dir() and (path / "cell.yaml").exists():
        from mbcacq.recording.datasets.observation_set import read_observation_set

        return read_observation_set(path)
    if path.is_file() and path.suffix.lower() in (".csv", ".tsv"):
        from mbcacq.recording.datasets.hand_eye_sets import read_hand_eye_files
        from mbcacq.recording.datasets.loose_table import TableOptions

        found = read_hand_eye_files([path], TableOptions())
        return replace(found.observations, understood=found.sentences)
    if _is_recording(path):
        from mbcacq.recording.rrd.reader import read_observations

        return read_observations(path)
    if path.is_dir() and any((path / name).exists() for name in ("result.json", "journal.jsonl", "recording.json")):
        raise ConfigError(f"{path} is a run folder without its recording run.rrd: copied by half, or moved; copy the whole folder again")
    if path.is_dir() and (below := sorted(each.name for each in path.iterdir() if _is_recording(each))):
        raise ConfigError(f"{path} is a folder of {len(below)} runs, not a run; give one of them, such as {path / below[-1]}")
    raise ConfigError(f"{path} is not a recording or an observation set; give {ACCEPTED}")


def load_whole_trajectories(paths: Path | str | Iterable[Path | str]) -> list[Trajectory]:
    """Read one whole trajectory for each path; ``mbcacq.load_trajectories`` gives the moving stretches of a run instead.

    Parameters
    ----------
    paths
        Trajectory-set folders, or run folders or .rrd files with controller cycles.

    Returns
    -------
    list of Trajectory
        In the order of the paths.

    Raises
    ------
    ConfigError
        A path is none of these, or its content is wrong.
    RecordingError
        A recording is torn.
    """
    return [_load_trajectory(Path(path)) for path in ([paths] if isinstance(paths, Path | str) else paths)]


def _load_trajectory(path: Path) -> Trajectory:
    from mbcacq.recording.datasets.trajectory_set import is_trajectory_set, read_trajectory_set

    if is_trajectory_set(path):
        return read_trajectory_set(path)
    if path.exists() and _is_recording(path):
        from mbcacq.recording.rrd.trajectory_recording import trajectory_of_run

        return trajectory_of_run(path)
    raise ConfigError(f"{path} holds no trajectory; give a trajectory-set folder (cell.yaml, trajectory.csv), a run folder or a .rrd file")


def _is_recording(path: Path) -> bool:
    return path.suffix == ".rrd" or (path.is_dir() and any(path.glob("run*.rrd")))


def __getattr__(name: str):
    """Import the class only when asked for: rerun takes a quarter of a second."""
    if name == "Recording":
        from mbcacq.recording.rrd.reader import Recording

        return Recording
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
