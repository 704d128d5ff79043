"""Resuming an interrupted run: which poses remain, which stations are measured anew, and the parts merged into one recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from mbcacq.errors import RecordingError
from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.recording.run_folder.progress import Progress, repair_and_read_progress
from mbcacq.recording.run_folder.recovery import make_readable
from mbcacq.recording.run_folder.run_plan import read_kept_plan, refuse_change
from mbcacq.workflow.load import load_observations


def progress_before(folder: Path | None, loaded: LoadedPlan, cell: str, message: Callable[[str], None]) -> Progress:
    """What an interrupted run has measured, its torn recordings made readable and its copies of the plan restored, with a sentence on each
    to ``message``; nothing of a run that begins, which has no folder. A plan that has grown (``workflow.extend``) was compared with that of
    the folder already.

    Raises ConfigError where there is no run, or where it belongs to another plan or another ``cell``.
    """
    if folder is None:
        return Progress(frozenset(), 0, {})
    progress = repair_and_read_progress(folder)
    kept = read_kept_plan(folder)
    if loaded.grown_from is None:
        refuse_change(folder, kept, loaded.text, loaded.files, cell)
    for sentence in (*progress.repairs, *kept.repairs):
        message(sentence)
    return progress


def partial_stations(poses: Sequence[PlannedPose], before: Progress) -> list[str]:
    """Stations of which some poses are measured and others remain."""
    remaining = {p.station for p in poses if p.number not in before.done}
    return sorted(remaining & set(before.stations))


def poses_to_skip(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], before: Progress, moved: Callable[[str], bool], measure_again: bool
) -> frozenset[int]:
    """Numbers of the poses that a resumed run passes over.

    An artefact that was touched since stands elsewhere, and its station must be measured as a whole. ``measure_again`` says so; if a person
    moves the artefacts, ``moved(station)``, asked of the first partly measured station, says so. A positioner is taken to have left it
    alone (a large move is found in the first scan).
    """
    partial = partial_stations(poses, before)
    if not measure_again and partial and loaded.plan.positioner.driver == "manual":
        measure_again = moved(partial[0])
    return without_partial_stations(poses, before) if measure_again else before.done


def without_partial_stations(poses: Sequence[PlannedPose], before: Progress) -> frozenset[int]:
    """The measured poses but for those at stations of which others remain."""
    remaining = {p.station for p in poses if p.number not in before.done}
    return before.done - {number for station in remaining for number in before.stations.get(station, ())}


def measured_balls(folder: Path, loaded: LoadedPlan, done: frozenset[int]) -> dict[str, dict[int, np.ndarray]]:
    """Where the balls stood at the poses that count as done: station -> ball id -> (3,) mm, mean over its poses, base frame of the nominal
    arm."""

    obs = load_observations(folder)
    T = obs.cell.robot.chain.flange(obs.q) @ loaded.cell.T_flange_scanner
    in_base = se3.apply(T[obs.pose], obs.xyz)
    measured: dict[str, dict[int, list[np.ndarray]]] = {}
    for row, (pose, ball) in enumerate(zip(obs.pose, obs.ball, strict=True)):
        if int(obs.pose_id[pose]) in done:
            station = obs.cell.stations[obs.station[pose]].id
            measured.setdefault(station, {}).setdefault(obs.cell.ball_ids[ball], []).append(in_base[row])
    return {station: {ball: np.mean(points, axis=0) for ball, points in balls.items()} for station, balls in measured.items()}


def merge_parts(folder: Path, message: Callable[[str], None]) -> None:
    """Merge the parts of a resumed run into one recording, whole.rrd; ``message`` gets a sentence where the disk does not take it."""
    try:
        make_readable(folder)
    except RecordingError as error:
        message(f"the parts of {folder} were not merged into one recording: {error}; later: mbcacq recover {folder}")
