"""Layout of a recording in the viewer: tabs from the cell to the calibration, and one of the diagnosis where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint import encodings

from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Cell
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.chart import SHEET_HEIGHT, SHEET_WIDTH, sheet_height
from mbcacq.recording.rrd.drawable import drawable
from mbcacq.recording.rrd.of_plan import of_plan
from mbcacq.recording.rrd.scan_colouring import RANGE_MM

Point = tuple[float, float, float]
WHOLE = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
NIGHT, GRID = [18, 21, 27], [70, 78, 92, 90]
LOG_COLUMNS = rrb.TextLogColumns(  # without the column of the time, which is too narrow to be read: it is part of the text
    timeline_columns=[encodings.TimelineColumn(layout.TIME, visible=False)],
    text_log_columns=[encodings.TextLogColumn(kind) for kind in ("LogLevel", "Body")],
)
ON_SPHERE = f"Scan: distance to the sphere, blue -{1e3 * RANGE_MM:.0f} µm, white 0, orange +{1e3 * RANGE_MM:.0f} µm"


@dataclass(frozen=True)
class Enlarged:
    """What there is to show. pose, all, diagnosis: how many times longer than they are arrows are drawn; None if there are none yet."""

    pose: float | None = None  # of the current pose, after calibration
    all: float | None = None  # of all poses, before and after
    diagnosis: float | None = None
    lengths: bool = False  # whether lengths were verified
    responses: tuple[str, ...] = ()  # titles of the charts of the diagnosis
    compared: bool = True  # whether there is a state before the calibration
    investigated: bool = False  # whether the cell chose its poses itself
    unit: str = "°"  # of positions of the axes


@dataclass(frozen=True)
class ViewerCamera:
    """Position of the viewer's camera and the point it looks at, mm in the base frame."""

    position: Point = (1900.0, -1900.0, 1500.0)
    target: Point = (450.0, 0.0, 450.0)


def blueprint(
    viewpoint: ViewerCamera = ViewerCamera(), enlarged: Enlarged = Enlarged(), live: bool = False, balls: int = 10
) -> rrb.Blueprint:
    """The tabs; that of the calibration without its curves until there are some, that of the diagnosis only where there is one. live:
    follow what comes. balls: how many the cell has."""
    diagnosis = (_diagnosis,) if enlarged.diagnosis is not None else ()
    investigation = (_investigation,) if enlarged.investigated else ()
    return rrb.Blueprint(
        rrb.Tabs(
            _cell(viewpoint, enlarged, balls),
            *(build(viewpoint, enlarged) for build in (_motion, _spheres, *investigation, _calibration, *diagnosis)),
            active_tab=0,
            name="mbcacq",
        ),
        *collapsed(layout.TIME, play_state="following" if live else "paused"),
    )


def collapsed(timeline: str, **time: Any) -> tuple[rrb.TimePanel, rrb.SelectionPanel, rrb.BlueprintPanel]:
    """The panels around the views, folded away. time: more of the time panel."""
    return (
        rrb.TimePanel(state="collapsed", timeline=timeline, **time),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _cell(viewpoint: ViewerCamera, enlarged: Enlarged, balls: int) -> rrb.Container:
    arrows = "" if enlarged.pose is None else f"; pink arrows: error after calibration, {enlarged.pose:g} times enlarged"
    contents = [f"+ /{layout.WORLD}/**", f"+ /{layout.URDF}/**", f"- /{layout.SCAN}", f"- /{layout.CALIBRATED}/**"]
    cell = space(f"Cell in mm, current station bright{arrows}", contents, viewpoint, hidden=(layout.PATH,))
    states = rrb.StateTimelineView(name="State", contents=[f"/{layout.STATE}", f"/{layout.STEP}", f"/{layout.STATION}"])
    texts = rrb.Tabs(
        *((rrb.TextDocumentView(name="Verdict", origin=layout.VERDICT),) if enlarged.pose is not None else ()),
        rrb.TextLogView(name="Log", origin=layout.LOG, columns=LOG_COLUMNS),
        rrb.TextDocumentView(name="Plan", origin=layout.PLAN_SHOWN),
        rrb.TextDocumentView(name="Cell description", origin=layout.CELL_SHOWN),
    )
    found = _curves("Balls found", [layout.BALLS_FOUND], legend=False, most=10 * -(-balls // 10) + 1)  # round, and its label in the frame
    return rrb.Horizontal(
        rrb.Vertical(cell, states, row_shares=[8, 2.3]),
        rrb.Vertical(texts, _scan(), found, row_shares=[3, 5, 2]),
        column_shares=[3, 2],
        name="Cell",
    )


def _motion(viewpoint: ViewerCamera, enlarged: Enlarged) -> rrb.Container:
    axes = rrb.Vertical(
        _curves(
            f"Joint positions: commanded (broad), actual (thin), {enlarged.unit}", [layout.SET, layout.JOINTS], legend=False, whole=True
        ),
        rrb.Horizontal(
            _curves(f"Following error (commanded minus actual), {enlarged.unit}", [layout.FOLLOWING], legend=False, whole=True),
            _curves("Motor current, % of the largest", [layout.CURRENT], legend=False, whole=True),
        ),
        row_shares=[15, 8],
    )
    names = rrb.Spatial2DView(
        name="Axes",
        origin=f"/{layout.AXES_KEY}",
        background=rrb.Background(color=NIGHT),
        visual_bounds=rrb.VisualBounds2D(x_range=(-30.0, 60.0), y_range=(-20.0, 420.0)),
    )
    return rrb.Vertical(
        rrb.Horizontal(axes, names, column_shares=[12, 1]),
        rrb.Horizontal(
            _curves("Cycle period, ms", [layout.PERIOD], whole=True),
            _curves("Answers late, count", [layout.DELAY], legend=False, whole=True),
            _curves("Temperatures, °C", [f"{layout.TEMPERATURE}/**"], whole=True),
        ),
        row_shares=[23, 6],
        name="Motion",
    )


def _investigation(viewpoint: ViewerCamera, enlarged: Enlarged) -> rrb.Container:
    return rrb.Vertical(
        _curves("Explanations: log10 of their odds against the first, before each visit", [f"{layout.ODDS}/**"], whole=True),
        _curves("Effects that could hide: log10 of the largest size not excluded, in usual ones", [f"{layout.COULD_HIDE}/**"], whole=True),
        name="Investigation",
    )


def _spheres(viewpoint: ViewerCamera, enlarged: Enlarged) -> rrb.Container:
    return rrb.Horizontal(
        rrb.Vertical(
            _scan(),
            _curves("Scatter between exposures, and fit residual, µm", [layout.SCATTER, layout.FIT_RMS], from_zero=True),
            row_shares=[3, 1],
        ),
        rrb.Vertical(
            _curves("Fit residual of each ball (rms) and its limit, µm", [layout.BALL_RMS, f"{layout.LIMITS}/rms"], from_zero=True),
            rrb.Horizontal(
                _curves("Form of each ball (95 % of the points), µm", [layout.BALL_FORM], legend=False, from_zero=True),
                _curves("Mean distance to the certified radius, µm", [layout.BALL_SIZE, f"{layout.LIMITS}/zero"], legend=False),
            ),
            _curves(
                "Points on each ball and the fewest accepted", [layout.BALL_POINTS, f"{layout.LIMITS}/points"], legend=False, from_zero=True
            ),
            row_shares=[6, 5, 5],  # lower ones have too little height for more than the zero beside their axis
        ),
        column_shares=[2, 3],
        name="Spheres",
    )


def _calibration(viewpoint: ViewerCamera, enlarged: Enlarged) -> rrb.Container:
    shown = "before (orange) and after (blue)" if enlarged.compared else "after calibration"
    title = "The cell" if enlarged.all is None else f"Errors {shown}, {enlarged.all:g} times enlarged"
    errors = space(
        title, [f"+ /{layout.ALL_ARROWS}/**", f"+ /{layout.URDF}/**", f"+ /{layout.ROBOT}/**", f"+ /{layout.CALIBRATED}/**"], viewpoint
    )
    result = rrb.TextDocumentView(name="Result", origin=layout.SUMMARY)
    if enlarged.lengths:
        result = rrb.Tabs(rrb.TextDocumentView(name="Verdict", origin=layout.VERDICT), result)
    if enlarged.all is None:
        return rrb.Horizontal(errors, result, column_shares=[2, 1], name="Calibration")
    return rrb.Horizontal(
        rrb.Vertical(errors, result, row_shares=[1, 1]),
        rrb.Vertical(
            *((_chart("Length error at each place, mm, with its uncertainty and the limit", layout.LENGTHS),) if enlarged.lengths else ()),
            _residuals(enlarged.compared),
            _curves("After, mean of the pose along x, y, z, µm", [f"{layout.RESIDUAL}/after"]),
            row_shares=[6, 5, 4] if enlarged.lengths else [1, 1],
        ),
        column_shares=[1, 1],
        name="Calibration",
    )


def _residuals(compared: bool) -> rrb.Container | rrb.View:
    """compared: before and after together, and after alone, which is small beside the other."""
    title, entity = "Residual of each pose (3D rms), µm", layout.RMS_POSE
    if not compared:
        return _curves(title, [f"{entity}/after"], legend=False, from_zero=True)
    alone = _curves("After alone (3D rms), µm", [f"{entity}/after"], legend=False, from_zero=True)
    return rrb.Horizontal(_curves(title, [f"{entity}/**"], from_zero=True), alone)


def _diagnosis(viewpoint: ViewerCamera, enlarged: Enlarged) -> rrb.Container:
    title = (
        "The cell"
        if enlarged.diagnosis is None
        else (f"Recorded centres (white), differences to the model before (orange) and after (blue), {enlarged.diagnosis:g} times enlarged")
    )
    cell = space(title, [f"+ /{layout.DIAGNOSIS}/cell/**", f"+ /{layout.URDF}/**", f"+ /{layout.ROBOT}/**"], viewpoint)
    text = rrb.TextDocumentView(name="Diagnosis", origin=layout.DIAGNOSIS_TEXT)
    if enlarged.diagnosis is None:
        return rrb.Horizontal(cell, text, column_shares=[2, 1], name="Diagnosis")
    height = sheet_height(len(enlarged.responses))
    charts = [_chart(title, f"{layout.RESPONSES}/{k}", height) for k, title in enumerate(enlarged.responses)]
    if not charts:
        charts = [_curves("Difference between model and data at each pose (3D rms), µm", [f"{layout.MISFIT}/**"], from_zero=True)]
    return rrb.Horizontal(rrb.Vertical(text, cell, row_shares=[3, 3]), rrb.Vertical(*charts), column_shares=[1, 1], name="Diagnosis")


def _chart(name: str, entity: str, height: float = SHEET_HEIGHT) -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(x_range=(0.0, SHEET_WIDTH), y_range=(0.0, height))
    return rrb.Spatial2DView(name=drawable(name), origin=f"/{entity}", background=rrb.Background(color=NIGHT), visual_bounds=bounds)


def space(name: str, contents: list[str], viewpoint: ViewerCamera, hidden: tuple[str, ...] = ()) -> rrb.Spatial3DView:
    """hidden: entities that are there but not shown until they are switched on."""
    return rrb.Spatial3DView(
        name=name,
        overrides={entity: rrb.EntityBehavior(visible=False) for entity in hidden},
        origin=layout.WORLD,
        contents=contents,
        background=rrb.Background(color=NIGHT),
        line_grid=rrb.LineGrid3D(visible=True, spacing=100.0, color=GRID),
        eye_controls=rrb.EyeControls3D(position=viewpoint.position, look_target=viewpoint.target, eye_up=(0.0, 0.0, 1.0)),
    )


def _scan() -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=ON_SPHERE,
        origin=layout.SCAN,
        contents=[f"+ /{layout.ON_BALLS}", f"+ /{layout.BACKGROUND}"],
        background=rrb.Background(color=NIGHT),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=(22.0, -85.0, 90.0), look_target=(0.0, 0.0, -5.0), eye_up=(0.0, 0.0, 1.0)),
    )


def _curves(
    name: str, entities: list[str], legend: bool = True, most: float | None = None, from_zero: bool = False, whole: bool = False
) -> rrb.TimeSeriesView:
    """most: upper end of an axis that begins at 0; without it the axis fits what is shown, with from_zero zero too. whole: from the first
    to the last value in time."""
    axis = None if most is None else rrb.ScalarAxis(range=(0.0, most))
    zero = [f"{layout.LIMITS}/zero"] if from_zero else []
    return rrb.TimeSeriesView(
        name=name,
        contents=[f"+ /{e}" for e in dict.fromkeys(entities + zero)],
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=legend),
        axis_y=axis,
        axis_x=rrb.TimeAxis(view_range=WHOLE) if whole else None,
    )


def curves_over_time(name: str, entities: list[str]) -> rrb.TimeSeriesView:
    """Curves from their first to their last value in time; the name says what each colour is."""
    return _curves(drawable(name), entities, legend=False, whole=True)


def alone(viewpoint: ViewerCamera, diagnosis: float, responses: Sequence[str] = (), motion: Sequence[rrb.Container] = ()) -> rrb.Blueprint:
    """The tab of a diagnosis as the whole window, for a recording that holds nothing else. motion: tabs of a diagnosis of the motion."""
    poses = _diagnosis(viewpoint, Enlarged(diagnosis=diagnosis, responses=tuple(responses)))
    return rrb.Blueprint(rrb.Tabs(poses, *motion, active_tab=0) if motion else poses, *collapsed(layout.POSE))


def for_cell(cell: Cell, plan_yaml: str, enlarged: Enlarged = Enlarged(), live: bool = False) -> rrb.Blueprint:
    """The blueprint with its camera placed so that the arm and the planned stations fill the view."""
    shown = replace(enlarged, unit="°, cm of axes that slide") if cell.robot.chain.sliding else enlarged
    return blueprint(place_camera(cell.robot.chain, stations(plan_yaml)), shown, live, len(cell.ball_ids))


def place_camera(chain: Chain, places: np.ndarray) -> ViewerCamera:
    """The camera that has the arm and some places (S, 3) mm in view."""
    reach = float(np.sum(np.hypot(chain.a, chain.d)))
    aim = places.mean(axis=0) if len(places) else np.array([0.5 * reach, 0.0, 0.3 * reach])
    target = 0.5 * aim + np.array([0.0, 0.0, 0.22 * reach])
    side = -1.0 if aim[1] <= 0 else 1.0
    size = max(0.66 * reach, float(np.ptp(places, axis=0).max()) if len(places) else 0.0)
    position = target + size * np.array([0.95, side * 1.25, 0.7])
    return ViewerCamera(_point(position), _point(target))


def _point(xyz: np.ndarray) -> Point:
    x, y, z = xyz.tolist()
    return x, y, z


def stations(plan_yaml: str) -> np.ndarray:
    """(S, 3) planned places, none where the run has no plan of that form."""

    def read(plan: Any) -> np.ndarray:
        return np.array([station["pose_in_base"]["translation_mm"] for station in plan["stations"]], dtype=float).reshape(-1, 3)

    return of_plan(plan_yaml, read, np.zeros((0, 3)))
