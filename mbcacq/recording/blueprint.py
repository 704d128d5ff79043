"""How a recording is shown: the cell in 3D on the left; curves, quality, state and log on the right."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb
import yaml

from mbcacq.geometry.chain import Chain
from mbcacq.recording import layout

Point = tuple[float, float, float]


def blueprint(eye: Point = (1900.0, -1900.0, 1500.0), target: Point = (450.0, 0.0, 450.0)) -> rrb.Blueprint:
    """eye, target: where the camera of the cell stands and looks, mm in the base frame."""
    cell = rrb.Spatial3DView(
        name="Cell", origin=layout.WORLD, background=rrb.Background(color=[18, 21, 27]),
        line_grid=rrb.LineGrid3D(visible=True, spacing=100.0, color=[70, 78, 92, 90]),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
    )
    scan = rrb.Spatial3DView(
        name="Scan", origin=layout.SCAN, contents=[f"/{layout.SCAN}"], background=rrb.Background(color=[12, 14, 18]),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=(22.0, -70.0, 68.0), look_target=(0.0, 0.0, -10.0), eye_up=(0.0, 0.0, 1.0)),
    )
    joints = rrb.Tabs(
        rrb.TimeSeriesView(name="Joints, deg", origin=layout.JOINTS),
        rrb.TimeSeriesView(name="Set point minus measured, deg", origin=layout.FOLLOWING),
        rrb.TimeSeriesView(name="Motor current, %", origin=layout.CURRENT),
        rrb.TimeSeriesView(name="Health", origin=layout.HEALTH),
    )
    quality = rrb.Tabs(
        rrb.TimeSeriesView(name="Sphere fit, um", contents=[f"/{layout.FIT_RMS}", f"/{layout.SCATTER}"]),
        rrb.TimeSeriesView(name="Balls found", origin=layout.BALLS_FOUND),
        rrb.TimeSeriesView(name="Residuals, um", contents=[f"/{layout.RESIDUAL}/**"]),
    )
    state = rrb.StateTimelineView(name="State", contents=[f"/{layout.STATE}", f"/{layout.STEP}", f"/{layout.STATION}"])
    texts = rrb.Tabs(
        rrb.TextLogView(name="Log", origin=layout.LOG),
        rrb.TextDocumentView(name="Plan", origin=layout.PLAN),
        rrb.TextDocumentView(name="Cell description", origin=layout.CELL),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(cell, state, row_shares=[9, 2]),
            rrb.Vertical(scan, joints, quality, texts, row_shares=[5, 4, 3, 3]),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def for_cell(chain: Chain, plan_yaml: str) -> rrb.Blueprint:
    """The blueprint with its camera placed so that the arm and the planned stations fill the view."""
    return blueprint(*camera(chain, _stations(plan_yaml)))


def camera(chain: Chain, places: np.ndarray) -> tuple[Point, Point]:
    """Where to stand and where to look (mm, base frame) to have the arm and some places (S, 3) in view."""
    reach = float(np.sum(np.hypot(chain.a, chain.d)))
    aim = places.mean(axis=0) if len(places) else np.array([0.5 * reach, 0.0, 0.3 * reach])
    target = 0.5 * aim + np.array([0.0, 0.0, 0.22 * reach])
    side = -1.0 if aim[1] <= 0 else 1.0
    size = max(0.75 * reach, float(np.ptp(places, axis=0).max()) if len(places) else 0.0)
    eye = target + size * np.array([0.95, side * 1.25, 0.7])
    return tuple(eye.tolist()), tuple(target.tolist())


def _stations(plan_yaml: str) -> np.ndarray:
    """(S, 3) planned places, none where the run has no plan of that form."""
    try:
        places = [station["pose_in_base"]["translation_mm"] for station in yaml.safe_load(plan_yaml)["stations"]]
        return np.array(places, dtype=float).reshape(-1, 3)
    except (yaml.YAMLError, KeyError, TypeError, ValueError):
        return np.zeros((0, 3))
