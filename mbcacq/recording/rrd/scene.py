"""The cell drawn from its numbers: links as capsules along the MD-H rows, joints as drums, the scanner with its field of view."""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np
import rerun as rr
from rerun.components import MarkerShape

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.link_shapes import link_corners, link_radii
from mbcacq.model.cell import Artefact, Cell
from mbcacq.quantities import from_degrees
from mbcacq.recording.datasets import quaternions
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.drawable import drawable, drawn_text
from mbcacq.recording.rrd.drawn_later import Stream
from mbcacq.recording.rrd.of_plan import of_plan

ARM, JOINT, FLANGE, BASE = (240, 106, 22), (52, 56, 64), (176, 182, 190), (84, 90, 100)
HOUSING, VIEW, BALL, BAR, PALE = (38, 70, 112), (86, 180, 233), (232, 236, 242), (150, 158, 168), (62, 68, 78)
CURVES = [(86, 180, 233), (230, 159, 0), (0, 190, 140), (213, 94, 0), (204, 121, 167), (240, 228, 66), (150, 160, 255), (180, 180, 180)]
MARKERS = [MarkerShape.Circle, MarkerShape.Diamond, MarkerShape.Square, MarkerShape.Up, MarkerShape.Cross, MarkerShape.Plus]
LIMIT = (255, 255, 255)  # no ball and no series has it
LARGEST_BOX = 2000.0  # mm
SHAFT = 1e-6  # mm; a shorter offset is no link to draw


def log_static(rec: rr.RecordingStream, cell: Cell, plan_yaml: str, *, view: bool = True, links: bool = True) -> None:
    """Everything that does not change: axes, arm, scanner housing and field of view (if it has one), curve names and colours.

    links: draw the arm from its MD-H rows; not where a URDF draws it.
    """
    rec.log(layout.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if links:
        _log_arm(rec, cell.robot.chain)
    if view:
        _log_scanner(rec, _field_of_view(plan_yaml))
    log_series(rec, cell.robot.drawn_axes if cell.robot.chain.sliding else cell.robot.axes)
    states = {
        "connecting": (130, 130, 130),
        "moving": (86, 180, 233),
        "settling": (240, 228, 66),
        "scanning": (0, 190, 140),
        "waiting": (204, 121, 167),
        "paused": (230, 159, 0),
        "stopped": (120, 60, 60),
    }
    rec.log(layout.STATE, rr.StateConfiguration(values=list(states), labels=list(states), colors=list(states.values())), static=True)


def log_series(rec: rr.RecordingStream, axes: tuple[str, ...]) -> None:
    """Names and colours of the curves. Set points are broad and pale, measured values are thin lines on top of them."""
    colours = (CURVES * 2)[: len(axes)]
    for entity in (layout.JOINTS, layout.FOLLOWING, layout.CURRENT):
        rec.log(entity, rr.SeriesLines(names=axes, colors=colours, widths=[1.3]), static=True)
    rec.log(
        layout.SET, rr.SeriesLines(names=[f"{a} commanded" for a in axes], colors=[(*c, 90) for c in colours], widths=[4.0]), static=True
    )
    log_axes_key(rec, axes)
    rec.log(
        layout.PERIOD,
        rr.SeriesLines(names=["controller, ms", "this computer, ms"], colors=[CURVES[0], CURVES[1]], widths=[1.3]),
        static=True,
    )
    rec.log(layout.DELAY, rr.SeriesLines(names=["late answers"], colors=[CURVES[3]], widths=[1.3]), static=True)
    for entity, name, colour in (
        (layout.BALLS_FOUND, "balls found", CURVES[2]),
        (layout.FIT_RMS, "sphere fit rms, µm", CURVES[0]),
        (layout.SCATTER, "scatter between exposures, µm", CURVES[1]),
    ):
        rec.log(entity, rr.SeriesPoints(names=[name], colors=[colour], marker_sizes=[3.0]), static=True)


def log_axes_key(rec: rr.RecordingStream, axes: tuple[str, ...]) -> None:
    """Names and colours of the axes, shown beside their curves."""
    n = len(axes)
    places = np.column_stack([np.zeros(n), 30.0 * np.arange(n)])
    rec.log(layout.AXES_KEY, rr.Points2D(places, colors=(CURVES * 2)[:n], radii=8.0, labels=axes, show_labels=True), static=True)


def log_ball_series(rec: Stream, cell: Cell) -> None:
    """Names, colours and markers of the curves that have one value a ball."""
    names = [f"ball {b}" for b in cell.ball_ids]
    k = len(names)
    colours = [CURVES[i % len(CURVES)] for i in range(k)]
    markers = [MARKERS[i // len(CURVES) % len(MARKERS)] for i in range(k)]
    for entity in (layout.BALL_POINTS, layout.BALL_RMS, layout.BALL_FORM, layout.BALL_SIZE):
        rec.log(entity, rr.SeriesPoints(names=names, colors=colours, markers=markers, marker_sizes=[2.5] * k), static=True)


def log_obstacles(rec: Stream, plan_yaml: str) -> None:
    """The plan's boxes, as outlines; those that would only frame the whole scene (a floor) are left to the grid."""

    def read(plan: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
        return [(str(o["name"]), np.array(o["min_mm"], float), np.array(o["max_mm"], float)) for o in plan["obstacles"]]

    boxes = of_plan(plan_yaml, read, [])
    boxes = [(name, low, high) for name, low, high in boxes if np.max(high - low) <= LARGEST_BOX]
    if boxes:
        rec.log(
            layout.OBSTACLES,
            rr.Boxes3D(
                centers=[(low + high) / 2 for _, low, high in boxes],
                half_sizes=[(high - low) / 2 for _, low, high in boxes],
                labels=[drawable(name) for name, _, _ in boxes],
                show_labels=False,
                colors=[BASE],
                radii=rr.Radius.ui_points(1.0),
            ),
            static=True,
        )


class TransformColumns(TypedDict):
    """Arguments of Transform3D: translation (k, 3) mm, quaternion (k, 4) x, y, z, w."""

    translation: np.ndarray
    quaternion: np.ndarray


def transforms(T: np.ndarray) -> TransformColumns:
    """(k, 4, 4) as the arguments of Transform3D."""
    return {"translation": T[:, :3, 3].astype(np.float32), "quaternion": quaternions.from_matrix(T[:, :3, :3])[:, [1, 2, 3, 0]]}


def placed(T: np.ndarray) -> rr.Transform3D:
    """At a pose (4, 4)."""
    move = transforms(T[None])
    return rr.Transform3D(translation=move["translation"][0], quaternion=move["quaternion"][0])


def arm_frames(cell: Cell, q: np.ndarray) -> dict[str, np.ndarray]:
    """Entity -> (k, 4, 4) T_base_link of every link and T_base_scanner, for q (k, n) rad."""
    frames = cell.robot.chain.frames(q)
    moving = {layout.link(i): frames[:, i] for i in range(1, cell.robot.n + 1)}
    return {**moving, layout.SCANNER: frames[:, -1] @ cell.T_flange_scanner}


def log_arm(rec: Stream, cell: Cell, q: np.ndarray) -> None:
    """The arm at one posture q (n,) rad, at the times set on the stream."""
    for entity, T in arm_frames(cell, q[None]).items():
        rec.log(entity, placed(T[0]))


def log_texts(rec: rr.RecordingStream, plan_yaml: str, cell_yaml: str) -> None:
    """Plan and cell as the viewer can draw them."""
    for entity, text in ((layout.PLAN_SHOWN, plan_yaml), (layout.CELL_SHOWN, cell_yaml)):
        rec.log(entity, drawn_text(text, markdown=False), static=True)


def log_balls(rec: Stream, station: str, artefact: Artefact, balls: dict[int, np.ndarray]) -> None:
    """Measured balls of one station: id -> centre (3,) mm in the base frame. Two of them are joined by their bar."""
    entity = f"{layout.STATIONS}/{rr.escape_entity_path_part(station)}"
    centres = np.array(list(balls.values()))
    diameter = dict(zip(artefact.ball_ids, artefact.diameters, strict=True))
    radius = np.array([max(diameter[ball] / 2, 1.0) for ball in balls])
    rec.log(
        entity,
        rr.Ellipsoids3D(
            centers=centres,
            half_sizes=np.repeat(radius[:, None], 3, axis=1),
            colors=[BALL],
            fill_mode="solid",
            labels=[drawable(f"{station}: {ball}") for ball in balls],
            show_labels=False,
        ),
    )
    if len(artefact.ball_ids) == 2 and len(balls) == 2:
        rec.log(f"{entity}/bar", rr.LineStrips3D([centres], colors=[BAR], radii=[float(radius.min()) * 0.4]))


def fade_balls(rec: Stream, station: str, bright: bool) -> None:
    """Another colour for the balls of a station, and for its bar: bright where the arm is, pale elsewhere."""
    entity = f"{layout.STATIONS}/{rr.escape_entity_path_part(station)}"
    rec.log(entity, rr.Ellipsoids3D.from_fields(colors=[BALL if bright else PALE]))
    rec.log(f"{entity}/bar", rr.LineStrips3D.from_fields(colors=[BAR if bright else PALE]))


def log_limits(rec: Stream) -> None:
    """Names and colours of the limits that the spheres are judged by."""
    for name, label in (("rms", "limit"), ("points", "fewest"), ("zero", "zero")):
        colour = BASE if name == "zero" else LIMIT
        rec.log(f"{layout.LIMITS}/{name}", rr.SeriesLines(names=[label], colors=[colour], widths=[1.5]), static=True)


def _log_arm(rec: rr.RecordingStream, chain: Chain) -> None:
    thick, corners = link_radii(chain), link_corners(chain)
    floor = chain.floor
    foot = max(0.45 * abs(float(chain.d[floor])), 0.4 * thick[0])
    rec.log(
        f"{layout.link(floor) if floor else layout.ROBOT}/base",
        rr.Cylinders3D(
            lengths=[foot, 0.18 * foot],
            radii=[1.35 * thick[0], 1.9 * thick[0]],
            centers=[[0, 0, foot / 2], [0, 0, 0.09 * foot]],
            colors=[BASE],
            fill_mode="solid",
        ),
        static=True,
    )
    step = se3.inverse(chain.link_transforms(-chain.sign * chain.theta[None])[0])
    for i, radius in enumerate(thick, floor):
        corner = corners[i]
        axis = step[i][:3, 2]
        if i == floor and chain.d[i] > foot:
            corner[0] = corner[0] + axis * foot
        last = i == chain.n - 1
        _log_capsules(rec, f"{layout.link(i + 1)}/body", corner, 0.8 * radius, FLANGE if last else ARM)
        if not last:
            rec.log(
                f"{layout.link(i + 1)}/joint",
                rr.Cylinders3D(
                    lengths=[2.1 * radius],
                    radii=[1.02 * radius],
                    centers=[corner[0]],
                    quaternions=[_z_to(axis)],
                    colors=[JOINT],
                    fill_mode="solid",
                ),
                static=True,
            )
    rec.log(f"{layout.link(chain.n)}/axes", rr.TransformAxes3D(axis_length=2.5 * float(thick[-1])), static=True)


def _log_capsules(rec: rr.RecordingStream, entity: str, corner: np.ndarray, radius: float, colour: tuple[int, int, int]) -> None:
    run = np.diff(corner, axis=0)
    length = np.linalg.norm(run, axis=1)
    real = length > SHAFT
    if not real.any():
        return
    rec.log(
        entity,
        rr.Capsules3D(
            lengths=length[real],
            radii=np.full(int(real.sum()), radius),
            translations=corner[:-1][real],
            quaternions=[_z_to(v / n) for v, n in zip(run[real], length[real], strict=True)],
            colors=[colour],
            fill_mode="solid",
        ),
        static=True,
    )


def _log_scanner(rec: rr.RecordingStream, view: dict[str, Any]) -> None:
    near, far = float(view["near_z_mm"]), float(view["far_z_mm"])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    faces = [
        np.column_stack([corners * np.array(half, dtype=float), np.full(4, z)])
        for half, z in ((view["near_half_mm"], near), (view["far_half_mm"], far))
    ]
    edges = [np.vstack([face, face[:1]]) for face in faces] + [np.stack([faces[0][k], faces[1][k]]) for k in range(4)]
    rec.log(f"{layout.SCANNER}/view", rr.LineStrips3D(edges, colors=[VIEW], radii=rr.Radius.ui_points(1.0)), static=True)
    if body := view.get("body_mm"):
        low, high = np.array(body, dtype=float)
        window = np.append((low + high)[:2] / 2, min(low[2], high[2]))
        rays = [np.stack([window, corner]) for corner in faces[0]]
        rec.log(f"{layout.SCANNER}/rays", rr.LineStrips3D(rays, colors=[(*VIEW, 90)], radii=rr.Radius.ui_points(0.5)), static=True)
        rec.log(
            f"{layout.SCANNER}/housing",
            rr.Boxes3D(centers=[(low + high) / 2], half_sizes=[(high - low) / 2], colors=[HOUSING], fill_mode="solid"),
            static=True,
        )
    rec.log(f"{layout.SCANNER}/axes", rr.TransformAxes3D(axis_length=40.0), static=True)


def home(plan_yaml: str, n: int) -> np.ndarray:
    """(n,) rad, the plan's home: how the arm is drawn until it reports itself."""
    q = of_plan(plan_yaml, lambda plan: from_degrees(np.array(plan["robot"]["home_deg"], dtype=float)), np.zeros(n))
    return q if q.shape == (n,) else np.zeros(n)


def _field_of_view(plan_yaml: str) -> dict[str, Any]:
    """The plan's field of view, or a small cone where the run has no plan of that form."""

    def read(plan: Any) -> dict[str, Any]:
        view = plan["scanner"]["field_of_view"]
        return {**view, "near_z_mm": float(view["near_z_mm"])}

    return of_plan(plan_yaml, read, {"near_z_mm": 20.0, "far_z_mm": -20.0, "near_half_mm": (30.0, 30.0), "far_half_mm": (40.0, 40.0)})


def _z_to(direction: np.ndarray) -> np.ndarray:
    """Quaternion (x, y, z, w) that turns the z axis into a unit vector (3,)."""
    x, y, z = direction
    if z < -1 + 1e-12:
        return np.array([1.0, 0, 0, 0])
    q = np.array([-y, x, 0.0, 1 + z])
    return q / np.linalg.norm(q)
