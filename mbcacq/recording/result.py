"""The calibrated cell beside its recording: residuals per pose and ball, station frames, error arrows. A file of the same recording."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import rerun as rr

from mbcacq.calibration.forward import CellState, predict, residual
from mbcacq.errors import RecordingError
from mbcacq.geometry import se3
from mbcacq.observations import Observations
from mbcacq.recording import layout, rows, scene
from mbcacq.recording.reader import open_recordings

ENLARGED = 500.0           # error arrows against true length
AXES = ("x", "y", "z")


def log_result(run: Path | str, observations: Observations, after: CellState, before: CellState | None = None) -> Path:
    """Write result.rrd into a run folder (replacing an older one); viewers show it together with the run.

    observations: those of the run, or any selection of them; poses of a station that the calibration did not determine (its
    T_base_station is the identity) are left out. after, before: the calibrated cell, and the cell to compare it with.
    Raises RecordingError where the run cannot be read or the file cannot be written.
    """
    run = Path(run)
    recordings = open_recordings(run)
    times = {int(row["pose"][0]): float(row["time_s"][0]) for recording in recordings for row in recording.observed()}
    path = run / layout.RESULT_FILE
    partial = path.with_name(".result.part.rrd")
    stream = rr.RecordingStream(layout.APPLICATION, recording_id=recordings[0].recording_id, send_properties=False)
    try:
        stream.save(partial)
        _log_static(stream)
        states = {"after": after} | ({"before": before} if before is not None else {})
        errors = {name: residual(observations, predict(observations, state))[:, :3] for name, state in states.items()}
        known = ~np.all(after.T_base_station == np.eye(4), axis=(1, 2))
        for k, number in enumerate(observations.pose_id.tolist()):
            if number not in times or not known[observations.station[k]]:
                continue
            stream.set_time(layout.TIME, duration=times[number])
            stream.set_time(layout.POSE, sequence=number)
            _log_pose(stream, observations, k, after, errors)
        _log_stations(stream, observations, after, known)
        stream.flush(timeout_sec=60.0)
        stream.disconnect()
        os.replace(partial, path)
    except (RuntimeError, OSError) as error:
        raise RecordingError(f"{path} cannot be written: {error}; free the disk or calibrate into another folder") from error
    finally:
        partial.unlink(missing_ok=True)
    return path


def _log_static(stream: rr.RecordingStream) -> None:
    for name, colours in (("before", [(120, 128, 140)] * 3), ("after", [(86, 180, 233), (230, 159, 0), (0, 190, 140)])):
        names = [f"{axis} {name}" for axis in AXES]
        stream.log(f"{layout.RESIDUAL}/{name}", rr.SeriesPoints(names=names, colors=colours, marker_sizes=[2.5]), static=True)


def _log_pose(stream: rr.RecordingStream, obs: Observations, k: int, after: CellState, errors: dict[str, np.ndarray]) -> None:
    mine = obs.pose == k
    if not mine.any():
        return
    for name, error in errors.items():
        stream.log(f"{layout.RESIDUAL}/{name}", rr.Scalars(1e3 * error[mine].mean(axis=0)))
    ball = np.array(obs.cell.ball_ids)[obs.ball[mine]]
    stream.log(layout.RESIDUAL_BALL, rows.row(layout.RESIDUAL_ARCHETYPE, pose=int(obs.pose_id[k]), ball=ball,
                                              **{f"{name}_mm": error[mine] for name, error in errors.items()}))
    T = after.chain.flange(obs.q[[k]])[0] @ after.T_flange_scanner
    origins = se3.apply(T, obs.xyz[mine])
    stream.log(layout.ARROWS, rr.Arrows3D(origins=origins, vectors=ENLARGED * errors["after"][mine] @ T[:3, :3].T,
                                          colors=[(255, 96, 96)], radii=[0.8], labels=[f"ball {b}" for b in ball], show_labels=False))


def _log_stations(stream: rr.RecordingStream, obs: Observations, after: CellState, known: np.ndarray) -> None:
    """Where the calibrated cell says each artefact stood, with its certified balls."""
    for s in np.flatnonzero(known):
        station = obs.cell.stations[s]
        artefact = obs.cell.artefact(station.artefact)
        entity = f"{layout.CALIBRATED}/{rr.escape_entity_path_part(station.id)}"
        move = scene.transforms(after.T_base_station[[s]])
        own = obs.cell.ball_artefact == obs.cell.artefacts.index(artefact)
        stream.log(entity, rr.Transform3D(translation=move["translation"][0], quaternion=move["quaternion"][0]),
                   rr.TransformAxes3D(axis_length=30.0), static=True)
        stream.log(f"{entity}/balls", rr.Points3D(after.balls[own], radii=rr.Radius.ui_points(2.5), colors=[(255, 200, 60)]), static=True)
