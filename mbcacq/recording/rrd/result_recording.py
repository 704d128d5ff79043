"""The calibrated cell next to its recording: residuals per pose and ball, station frames, error arrows. A file of the same recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import rerun as rr

from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.forward_model import CellState, predict, residual
from mbcacq.files.atomic_write import write_files
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations
from mbcacq.recording.rrd import layout, rows, scene
from mbcacq.recording.rrd.blueprint import Enlarged, for_cell
from mbcacq.recording.rrd.chart import Chart
from mbcacq.recording.rrd.checksums import note_made
from mbcacq.recording.rrd.drawable import drawn_text
from mbcacq.recording.rrd.new_stream import filed
from mbcacq.recording.rrd.reader import open_recordings

BALL_ARROW_MM, SPACE_ARROW = 60.0, 0.12  # length of a large error (95 %): of a pose, in mm; of all poses, as a share of their extent
BEFORE, AFTER = (230, 159, 0), (86, 180, 233)
CERTIFIED = (240, 228, 66)
ERROR = (255, 80, 190)  # an arrow that stands out from the arm, the balls and the field of view
AXES = ("x", "y", "z")
HAND_EYE_ALONE = "The hand-eye transform alone was fitted, the arm is taken as nominal."


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What the verification says. text: Markdown of the verdict; place: k names; error, sigma: (k,) mm, of each certified length and its
    standard uncertainty; before: (k,) mm; limit: mm, or None."""

    text: str
    place: Sequence[str] = ()
    before: np.ndarray = field(default_factory=lambda: np.zeros(0))
    error: np.ndarray = field(default_factory=lambda: np.zeros(0))
    sigma: np.ndarray | None = None
    limit: float | None = None


def log_result(
    run: Path | str,
    observations: Observations,
    after: CellState,
    before: CellState | None = None,
    judgement: Judgement | None = None,
    effects: EffectModel | None = None,
) -> Path:
    """Write result.rrd into a run folder (replacing an older one); viewers show it together with the run.

    observations: those of the run, or any selection of them; poses of a station that the calibration did not determine (its
    T_base_station is the identity) are left out. after, before: the calibrated cell, and the cell to compare it with. judgement: of its
    verification. effects: what the calibrated cell does beyond its geometry.
    Raises RecordingError where the run cannot be read or the file cannot be written.
    """
    run = Path(run)
    recordings = open_recordings(run)
    times = {int(row["pose"][0]): float(row["time_s"][0]) for recording in recordings for row in recording.observed()}
    states = {"before": before, "after": after} if before is not None else {"after": after}
    moved = {"after": effects.displacements(observations)} if effects else {}
    errors = {name: residual(observations, predict(observations, state, moved.get(name)))[:, :3] for name, state in states.items()}
    known = ~np.all(after.T_base_station == np.eye(4), axis=(1, 2))
    shown = known[observations.station[observations.pose]]
    verified = judgement is not None and len(judgement.error) > 0
    investigated = (run / layout.INVESTIGATION_FILE).exists()
    panels = {"lengths": verified, "compared": before is not None, "investigated": investigated}
    scale = replace(_scales(observations, after, errors, shown), **panels)
    blueprint = for_cell(observations.cell, recordings[0].text(layout.PLAN), scale)
    same = {"recording_id": recordings[0].recording_id, "send_properties": False}

    def write(partial: Path) -> None:
        with filed(partial, blueprint, **same) as stream:
            _log_static(stream, scale)
            for k, number in enumerate(observations.pose_id.tolist()):
                if number not in times or not known[observations.station[k]]:
                    continue
                stream.set_time(layout.TIME, duration=times[number])
                stream.set_time(layout.POSE, sequence=number)
                _log_pose(stream, observations, k, after, errors, scale.pose)
            stream.reset_time()
            _log_all(stream, observations, after, errors, shown, scale.all)
            _log_stations(stream, observations, after, known)
            if judgement is not None:
                _log_judgement(stream, judgement)
            stream.log(layout.SUMMARY, drawn_text(_summary(observations, errors, shown, scale)), static=True)

    (path,) = write_files(run, {layout.RESULT_FILE: write}, on_disk=lambda name, partial: note_made(partial, run / name))
    return path


def round_scale(wanted: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``wanted``; 1 for what is not a number above zero."""
    if not np.isfinite(wanted) or wanted <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1 + 1e-9)))


def _scales(obs: Observations, after: CellState, errors: dict[str, np.ndarray], shown: np.ndarray) -> Enlarged:
    if not shown.any():
        return Enlarged()
    large = {name: float(np.percentile(np.linalg.norm(error[shown], axis=1), 95)) for name, error in errors.items()}
    places = _in_base(obs, after)[0][shown]
    extent = float(np.max(np.subtract(*np.percentile(places, [90, 10], axis=0))))
    return Enlarged(
        pose=round_scale(BALL_ARROW_MM / max(large["after"], 1e-9)),
        all=round_scale(SPACE_ARROW * max(extent, 100.0) / max(max(large.values()), 1e-9)),
    )


def _in_base(obs: Observations, state: CellState) -> tuple[np.ndarray, np.ndarray]:
    """Measured centres (M, 3) mm in the base frame, and the rotation (M, 3, 3) of the scanner that measured them."""
    T = (state.chain.flange(obs.q) @ state.T_flange_scanner)[obs.pose]
    return se3.apply(T, obs.xyz), T[:, :3, :3]


def _log_static(stream: rr.RecordingStream, scale: Enlarged) -> None:
    for name, colours in (("before", [(120, 128, 140)] * 3), ("after", [(86, 180, 233), (230, 159, 0), (0, 190, 140)])):
        names = [f"{axis} {name}" for axis in AXES]
        stream.log(f"{layout.RESIDUAL}/{name}", rr.SeriesPoints(names=names, colors=colours, marker_sizes=[2.5]), static=True)
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        stream.log(f"{layout.RMS_POSE}/{name}", rr.SeriesPoints(names=[name], colors=[colour], marker_sizes=[3.0]), static=True)
    flags = {name: float(getattr(scale, name)) for name in ("lengths", "compared", "investigated")}
    values = flags | {name: value for name, value in (("pose", scale.pose), ("all", scale.all)) if value is not None}
    stream.log(layout.ENLARGED, rows.row(layout.ENLARGED_ARCHETYPE, **values), static=True)


def _log_pose(
    stream: rr.RecordingStream, obs: Observations, k: int, after: CellState, errors: dict[str, np.ndarray], scale: float | None
) -> None:
    mine = obs.pose == k
    if scale is None or not mine.any():  # without a scale no measured pose is shown
        return
    for name, error in errors.items():
        stream.log(f"{layout.RESIDUAL}/{name}", rr.Scalars(1e3 * error[mine].mean(axis=0)))
        stream.log(f"{layout.RMS_POSE}/{name}", rr.Scalars(1e3 * _rms(error[mine])))
    ball = np.array(obs.cell.ball_ids)[obs.ball[mine]]
    stream.log(
        layout.RESIDUAL_BALL,
        rows.row(
            layout.RESIDUAL_ARCHETYPE, pose=int(obs.pose_id[k]), ball=ball, **{f"{name}_mm": error[mine] for name, error in errors.items()}
        ),
    )
    T = after.chain.flange(obs.q[[k]])[0] @ after.T_flange_scanner
    origins = se3.apply(T, obs.xyz[mine])
    stream.log(
        layout.ARROWS,
        rr.Arrows3D(
            origins=origins,
            vectors=scale * errors["after"][mine] @ T[:3, :3].T,
            colors=[ERROR],
            radii=rr.Radius.ui_points(2.5),
            labels=[f"ball {b}" for b in ball],
            show_labels=False,
        ),
    )


def _log_all(
    stream: rr.RecordingStream, obs: Observations, after: CellState, errors: dict[str, np.ndarray], shown: np.ndarray, scale: float | None
) -> None:
    """Every error at once."""
    if scale is None:
        return
    origins, rotation = _in_base(obs, after)
    for name, error in errors.items():
        colour = BEFORE if name == "before" else AFTER
        vectors = scale * np.einsum("mij,mj->mi", rotation[shown], error[shown])
        stream.log(
            f"{layout.ALL_ARROWS}/{name}",
            rr.Arrows3D(origins=origins[shown], vectors=vectors, colors=[colour], radii=rr.Radius.ui_points(0.6)),
            static=True,
        )


def _log_judgement(stream: rr.RecordingStream, judged: Judgement) -> None:
    """The verdict, and the chart of the number that judges: the length error at each place."""
    stream.log(layout.VERDICT, drawn_text(judged.text), static=True)
    if not len(judged.error):
        return
    uncertainty = np.zeros(len(judged.error)) if judged.sigma is None else 2 * judged.sigma
    top = 1.15 * max(float(np.max(np.abs(judged.error) + uncertainty)), judged.limit or 0.0, 1e-6)
    x = np.arange(len(judged.error), dtype=float)
    chart = Chart(stream, layout.LENGTHS, (-0.6, len(x) - 0.4), (-top, top), [str(p) for p in judged.place])
    beyond = np.abs(judged.before) > top
    chart.points("before", x[~beyond], judged.before[~beyond], BEFORE, 5.0)
    if beyond.any():  # far above the limit, as before a calibration: marked at the edge with their value in the legend
        largest = float(np.max(np.abs(judged.before)))
        chart.points(f"before, up to {largest:.2f}", x[beyond], judged.before[beyond], BEFORE, 5.0)
    chart.bars("after", x, judged.error, 0.5, AFTER)
    if judged.sigma is not None:
        chart.whiskers("U (k = 2)", x, judged.error - uncertainty, judged.error + uncertainty)
    if judged.limit is not None:
        chart.level(f"limit {judged.limit:g} mm", (-judged.limit, judged.limit))


def _rms(error: np.ndarray) -> float:
    """Root mean square 3D length of (k, 3)."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _summary(obs: Observations, errors: dict[str, np.ndarray], shown: np.ndarray, scale: Enlarged) -> str:
    """The result in a few lines of Markdown, next to the picture."""
    if not shown.any():
        return "No pose at a calibrated station."
    lines = ["| residual of the poses shown | " + " | ".join(errors) + " |", "|---|" + "---|" * len(errors)]
    lengths = {name: 1e3 * np.linalg.norm(error[shown], axis=1) for name, error in errors.items()}
    for label, of in (("3D rms, µm", lambda v: np.sqrt(np.mean(v**2))), ("median, µm", np.median), ("largest, µm", np.max)):
        lines.append(f"| {label} | " + " | ".join(f"{of(v):.1f}" for v in lengths.values()) + " |")
    lines += [
        "",
        "Before: nominal arm with the hand-eye transform fitted. After: the calibrated cell." if "before" in errors else HAND_EYE_ALONE,
        f"Arrows here are {scale.all:g} times, those of the tab Cell {scale.pose:g} times as long as the errors.",
        "The whole result with uncertainties: report.html in the folder of the run.",
    ]
    ids = np.array(obs.cell.ball_ids)
    lines += ["", "| ball | " + " | ".join(f"{name}, 3D rms, µm" for name in errors) + " |", "|---|" + "---|" * len(errors)]
    for b in np.unique(obs.ball[shown]):
        lines.append(f"| {ids[b]} | " + " | ".join(f"{1e3 * _rms(e[shown & (obs.ball == b)]):.1f}" for e in errors.values()) + " |")
    return "\n".join(lines)


def _log_stations(stream: rr.RecordingStream, obs: Observations, after: CellState, known: np.ndarray) -> None:
    """Where the calibrated cell says each artefact stood, with its certified balls."""
    for s in np.flatnonzero(known):
        station = obs.cell.stations[s]
        artefact = obs.cell.artefact(station.artefact)
        entity = f"{layout.CALIBRATED}/{rr.escape_entity_path_part(station.id)}"
        own = obs.cell.ball_artefact == obs.cell.artefacts.index(artefact)
        stream.log(entity, scene.placed(after.T_base_station[s]), rr.TransformAxes3D(axis_length=30.0), static=True)
        half = np.repeat(np.maximum(artefact.diameters / 2, 1.0)[:, None], 3, axis=1)
        stream.log(
            f"{entity}/certified",
            rr.Ellipsoids3D(centers=after.balls[own], half_sizes=half, colors=[CERTIFIED], line_radii=rr.Radius.ui_points(0.6)),
            static=True,
        )
