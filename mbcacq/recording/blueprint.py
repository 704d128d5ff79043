"""How a recording is shown: the cell in 3D on the left; curves, quality, state and log on the right."""

from __future__ import annotations

import rerun.blueprint as rrb

from mbcacq.recording import layout

Point = tuple[float, float, float]


def blueprint(eye: Point = (1900.0, -1900.0, 1500.0), target: Point = (450.0, 0.0, 450.0)) -> rrb.Blueprint:
    """eye, target: where the camera stands and looks, mm in the base frame."""
    cell = rrb.Spatial3DView(
        name="Cell", origin=layout.WORLD, background=rrb.Background(color=[18, 21, 27]),
        line_grid=rrb.LineGrid3D(visible=True, spacing=100.0, color=[70, 78, 92, 90]),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
    )
    scan = rrb.Spatial3DView(
        name="Scan", origin=layout.SCAN, contents=[f"/{layout.SCAN}"], background=rrb.Background(color=[12, 14, 18]),
        line_grid=rrb.LineGrid3D(visible=False),
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
            rrb.Vertical(cell, state, row_shares=[5, 1]),
            rrb.Vertical(scan, joints, quality, texts, row_shares=[5, 4, 3, 3]),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
