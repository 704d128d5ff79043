"""Errors before and after as a recording of its own: arrows in the workspace, curves over the poses, the arm at each pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mbcacq.calibration.forward import CellState
from mbcacq.cell import TARGET_IN_BASE
from mbcacq.errors import RecordingError
from mbcacq.geometry import se3
from mbcacq.observations import Observations
from mbcacq.recording import layout, scene
from mbcacq.recording.blueprint import camera

ARROW_SHARE = 0.12         # of the extent of the measured places: how long a large error (95 %) before is drawn
COLOURS = {"before": (230, 110, 90), "after": (86, 180, 233)}


def write_comparison(path: Path | str, observations: Observations, state: CellState, before: np.ndarray, after: np.ndarray,
                     note: str = "") -> Path:
    """Write a .rrd that shows two sets of residuals of the same observations.

    state: the cell that places them in the base frame. before, after: (M, 3) mm, measured minus predicted, in the scanner's frame (the
    instrument's, for an external one). note: text (Markdown) to show beside. Raises RecordingError if the file cannot be written.
    """
    path, obs = Path(path), observations
    origins, turn = _in_base(obs, state)
    vectors = {"before": np.einsum("mij,mj->mi", turn, before[:, :3]), "after": np.einsum("mij,mj->mi", turn, after[:, :3])}
    enlarged = _scale(origins, vectors["before"])
    labels = [f"pose {p} ball {b}" for p, b in zip(obs.pose_id[obs.pose], np.array(obs.cell.ball_ids)[obs.ball], strict=True)]
    stream = rr.RecordingStream(f"{layout.APPLICATION}-comparison")
    try:
        stream.save(path, default_blueprint=_blueprint(obs, origins, enlarged, bool(note)))
        scene.log_static(stream, obs.cell, "", view=obs.cell.measurement != TARGET_IN_BASE)
        for name, vector in vectors.items():
            stream.log(f"{layout.ARROWS}/{name}", rr.Arrows3D(
                origins=origins, vectors=enlarged * vector, colors=[COLOURS[name]], radii=[rr.Radius.ui_points(1.5)], labels=labels,
                show_labels=False), static=True)
            stream.log(f"{layout.RESIDUAL}/{name}", rr.SeriesPoints(names=[name], colors=[COLOURS[name]], marker_sizes=[2.5]), static=True)
        _log_poses(stream, obs, state, vectors)
        if note:
            stream.log("note", rr.TextDocument(note, media_type=rr.MediaType.MARKDOWN), static=True)
        stream.flush(timeout_sec=60.0)
        stream.disconnect()
    except (RuntimeError, OSError) as error:
        raise RecordingError(f"{path} cannot be written: {error}; choose another place") from error
    return path


def _scale(origins: np.ndarray, vectors: np.ndarray) -> float:
    """How much to enlarge the errors: 1, 2 or 5 times a power of ten."""
    large = float(np.percentile(np.linalg.norm(vectors, axis=1), 95))
    extent = float(np.max(np.subtract(*np.percentile(origins, [90, 10], axis=0))))
    if large <= 0 or extent <= 0:
        return 1.0
    wanted = ARROW_SHARE * extent / large
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted))


def _in_base(obs: Observations, state: CellState) -> tuple[np.ndarray, np.ndarray]:
    """Measured centres (M, 3) mm in the base frame, and the rotation (M, 3, 3) of what measured them."""
    if obs.cell.measurement == TARGET_IN_BASE:
        T = state.T_base_station[obs.station]
    else:
        T = state.chain.flange(obs.q) @ state.T_flange_scanner
    T = T[obs.pose]
    return se3.apply(T, obs.xyz), T[:, :3, :3]


def _log_poses(stream: rr.RecordingStream, obs: Observations, state: CellState, vectors: dict[str, np.ndarray]) -> None:
    index = [rr.TimeColumn(layout.POSE, sequence=obs.pose_id)]
    for entity, T in scene.arm_frames(obs.cell, obs.q).items():
        stream.send_columns(entity, index, rr.Transform3D.columns(**scene.transforms(T)))
    count = np.bincount(obs.pose, minlength=obs.n_poses)
    seen = count > 0
    index = [rr.TimeColumn(layout.POSE, sequence=obs.pose_id[seen])]
    for name, vector in vectors.items():
        square = np.bincount(obs.pose, np.sum(vector**2, axis=1), minlength=obs.n_poses)
        rms = 1e3 * np.sqrt(square[seen] / count[seen])
        stream.send_columns(f"{layout.RESIDUAL}/{name}", index, rr.Scalars.columns(scalars=rms))


def _blueprint(obs: Observations, origins: np.ndarray, enlarged: float, note: bool) -> rrb.Blueprint:
    eye, target = camera(obs.cell.robot.chain, np.percentile(origins, [10, 50, 90], axis=0))
    cell = rrb.Spatial3DView(
        name=f"Errors, {enlarged:g} times enlarged", origin=layout.WORLD, background=rrb.Background(color=[18, 21, 27]),
        line_grid=rrb.LineGrid3D(visible=True, spacing=100.0, color=[70, 78, 92, 90]),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)))
    curves = rrb.TimeSeriesView(name="Residual of each pose (rms), um", contents=[f"/{layout.RESIDUAL}/**"])
    right = rrb.Vertical(curves, rrb.TextDocumentView(name="Diagnosis", origin="note")) if note else curves
    return rrb.Blueprint(rrb.Horizontal(cell, right, column_shares=[3, 2]), rrb.TimePanel(state="collapsed", timeline=layout.POSE),
                         rrb.SelectionPanel(state="collapsed"), rrb.BlueprintPanel(state="collapsed"))
