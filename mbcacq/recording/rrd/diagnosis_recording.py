"""A diagnosis as a recording: differences between model and data, before and after, and the misfit of each pose above its cause."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from mbcacq.effects.in_words import spelt_out
from mbcacq.files.atomic_write import replacing
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations
from mbcacq.quantities import capitalised
from mbcacq.recording.rrd import layout, rows, scene
from mbcacq.recording.rrd.blueprint import alone, place_camera
from mbcacq.recording.rrd.chart import GRID, Chart, sheet_height
from mbcacq.recording.rrd.drawable import drawable, drawn_text
from mbcacq.recording.rrd.motion_recording import MotionDrawn, log_motion, motion_tabs
from mbcacq.recording.rrd.new_stream import filed
from mbcacq.recording.rrd.reader import open_recordings
from mbcacq.recording.rrd.result_recording import AFTER, BEFORE, round_scale

ARROW_SHARE = 0.10  # of the extent of the measured places: how long a large difference (95 %) before is drawn
RECORDED = (235, 238, 242)
MOST_CHARTS = 4


def write_diagnosis(
    path: Path | str,
    observations: Observations,
    text: str,
    pictures: Mapping[str, Any],
    run: Path | None = None,
    motion: MotionDrawn | None = None,
) -> Path:
    """Write a .rrd of a diagnosis (``pictures`` as ``mbcacq.diagnosis.output.pictures`` makes them; text: the diagnosis as
    Markdown).

    run: the folder whose recording it belongs to; the viewer then shows both as one. Without it the file also holds the arm at each pose
    and is shown alone, with motion (the channels between the poses, on a timeline of their own) in further tabs. Raises RecordingError if
    it cannot be written.
    """
    with replacing(path) as partial:
        stream_diagnosis(partial, observations, text, pictures, run, motion)
    return Path(path)


def stream_diagnosis(
    partial: Path,
    observations: Observations,
    text: str,
    pictures: Mapping[str, Any],
    run: Path | None = None,
    motion: MotionDrawn | None = None,
) -> None:
    """The content of ``write_diagnosis`` into a file that is to become another. Raises RecordingError."""
    obs = observations
    centres = {name: np.asarray(values, float) for name, values in pictures["centres"].items() if isinstance(values, list)}
    point, before, after = (centres[name].reshape(-1, 3) for name in ("point_mm", "before_mm", "after_mm"))
    scale, curves = _scale(point, before), list(pictures.get("curves", ()))[:MOST_CHARTS]
    titles, height = [_response_title(curve) for curve in curves], sheet_height(len(curves))
    times, recording_id = _of_run(run)
    blueprint = None
    if run is None:
        places = np.percentile(point, [10, 50, 90], axis=0) if len(point) else np.zeros((0, 3))
        further = () if motion is None else motion_tabs(motion, f"Motion (timeline {layout.ROBOT_TIME})")
        blueprint = alone(place_camera(obs.cell.robot.chain, places), scale, titles, further)
    with filed(partial, blueprint, recording_id=recording_id, send_properties=run is None) as stream:
        if run is None:
            if motion is not None:
                log_motion(stream, motion)
            scene.log_static(stream, obs.cell, "", view=obs.cell.measurement != TARGET_IN_BASE)
            _log_arm(stream, obs)
        stream.log(layout.ENLARGED, rows.row(layout.ENLARGED_ARCHETYPE, diagnosis=scale, responses=titles), static=True)
        stream.log(layout.DIAGNOSIS_TEXT, drawn_text(text), static=True)
        _log_arrows(stream, point, before, after, scale)
        for k, cause in enumerate(pictures["causes"]):
            entity = f"{layout.CAUSE}/{rr.escape_entity_path_part(cause['name'])}"
            label = f"{cause['label']}, {cause['unit']}" if cause["unit"] else cause["label"]
            stream.log(entity, rr.SeriesPoints(names=[drawable(label)], colors=[scene.CURVES[k]], marker_sizes=[3.0]), static=True)
        for k, curve in enumerate(curves):
            _log_response(stream, f"{layout.RESPONSES}/{k}", curve, height)
        _log_poses(stream, centres, before, after, pictures["causes"], times)


def _log_arrows(stream: rr.RecordingStream, point: np.ndarray, before: np.ndarray, after: np.ndarray, scale: float) -> None:
    """The measured points (N, 3) mm with their differences from the model, enlarged, before and after."""
    for name, vectors, colour in (("before", before, BEFORE), ("after", after, AFTER)):
        stream.log(
            f"{layout.DIAGNOSIS_ARROWS}/{name}",
            rr.Arrows3D(origins=point - scale * vectors, vectors=scale * vectors, colors=[colour], radii=rr.Radius.ui_points(0.6)),
            static=True,
        )
        stream.log(f"{layout.MISFIT}/{name}", rr.SeriesPoints(names=[name], colors=[colour], marker_sizes=[3.0]), static=True)
    stream.log(layout.DIAGNOSIS_BALLS, rr.Points3D(point, colors=[RECORDED], radii=rr.Radius.ui_points(1.5)), static=True)


def _response_title(curve: Mapping[str, Any]) -> str:
    """What is drawn over what, with units, and which effect it is."""
    unit = f", {curve['x_unit']}" if curve["x_unit"] else ""
    return (
        f"{capitalised(spelt_out(str(curve['effect'])))} at {curve['at']}: {curve['what']}, {curve['unit']}, over {curve['x_label']}{unit}"
    )


def _log_response(stream: rr.RecordingStream, entity: str, curve: Mapping[str, Any], height: float) -> None:
    """The displacement of each pose over the variable that the effect depends on: before, the model, and what remains after."""
    x, model, before = (np.asarray(curve[name], float) for name in ("x", "y", "seen"))
    if len(x) == 0:
        return
    after = before - model
    low, high = np.percentile(np.concatenate([before, after, model]), [1, 99])
    pad = 0.1 * max(high - low, 1e-9)
    span = max(float(np.ptp(x)), 1e-9)
    chart = Chart(stream, entity, (x.min() - 0.03 * span, x.max() + 0.03 * span), (low - pad, high + pad), height=height)
    chart.level("", (0.0,), GRID)
    chart.points("before", x, before, BEFORE)
    chart.points("after", x, after, AFTER)
    chart.points("model", x, model, RECORDED, 1.4)


def _of_run(run: Path | None) -> tuple[dict[int, float], str | None]:
    """Run time (s) of each pose, and the recording id."""
    if run is None:
        return {}, None

    recordings = open_recordings(run)
    return {int(row["pose"][0]): float(row["time_s"][0]) for r in recordings for row in r.observed()}, recordings[0].recording_id


def _scale(point: np.ndarray, before: np.ndarray) -> float:
    if not len(point):
        return 1.0
    large = float(np.percentile(np.linalg.norm(before, axis=1), 95))
    extent = float(np.max(np.subtract(*np.percentile(point, [90, 10], axis=0))))
    return round_scale(ARROW_SHARE * max(extent, 100.0) / max(large, 1e-9))


def _log_arm(stream: rr.RecordingStream, obs: Observations) -> None:
    index = [rr.TimeColumn(layout.POSE, sequence=obs.pose_id)]
    for entity, T in scene.arm_frames(obs.cell, obs.q).items():
        stream.send_columns(entity, index, rr.Transform3D.columns(**scene.transforms(T)))


def _log_poses(
    stream: rr.RecordingStream,
    centres: dict[str, np.ndarray],
    before: np.ndarray,
    after: np.ndarray,
    causes: list[dict[str, Any]],
    times: dict[int, float],
) -> None:
    pose, of = np.unique(centres["pose"].astype(int), return_inverse=True)
    if not len(pose):
        return
    count = np.bincount(of)
    index = [rr.TimeColumn(layout.POSE, sequence=pose)]
    if times and all(int(p) in times for p in pose):
        index.append(rr.TimeColumn(layout.TIME, duration=np.array([times[int(p)] for p in pose])))
    for name, vector in (("before", before), ("after", after)):
        rms = 1e3 * np.sqrt(np.bincount(of, np.sum(vector**2, axis=1)) / count)
        stream.send_columns(f"{layout.MISFIT}/{name}", index, rr.Scalars.columns(scalars=rms))
    for cause in causes:
        mean = np.bincount(of, np.asarray(cause["values"], float)) / count
        stream.send_columns(f"{layout.CAUSE}/{rr.escape_entity_path_part(cause['name'])}", index, rr.Scalars.columns(scalars=mean))
