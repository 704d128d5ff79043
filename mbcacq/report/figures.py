"""Which figures a page shows, by name: each is drawn only where the content has its data."""

from __future__ import annotations

import numpy as np

from mbcacq.figure import Figure
from mbcacq.report.charts import (
    device_charts,
    diagnosis_charts,
    fleet_charts,
    motion_charts,
    parameter_charts,
    part_charts,
    residual_charts,
    sphere_charts,
    workspace_charts,
)
from mbcacq.report.content import Content, Coverage, Devices, DiagnosisContent, Residuals
from mbcacq.report.several import FleetContent


def report_figures(content: Content) -> dict[str, Figure]:
    """Figures of a report without its diagnosis."""
    figures: dict[str, Figure] = {}
    if content.residuals is not None and len(content.residuals.xyz):
        figures |= _residual_figures(content.residuals)
    if (spheres := content.spheres) is not None:
        figures |= {"sphere_rms": sphere_charts.sphere_quality(spheres), "sphere_points": sphere_charts.sphere_points(spheres)}
    if (part := content.part) is not None:
        figures["overlaps"] = part_charts.overlaps(part)
        if part.deviation_mm is not None:
            figures["deviation_map"] = part_charts.deviation_map(part)
    if content.correlation is not None and len(content.correlation[0]) > 1:
        figures["correlation"] = parameter_charts.correlation(*content.correlation)
    if (accuracy := content.accuracy) is not None:
        figures |= {"accuracy_top": workspace_charts.accuracy(accuracy, 1), "accuracy_side": workspace_charts.accuracy(accuracy, 2)}
    if content.coverage is not None and len(content.coverage.phase):
        figures |= _coverage_figures(content.coverage)
    if content.devices is not None:
        figures |= _device_figures(content.devices)
    if content.arm_improved is not None:
        figures["arm_improved"] = residual_charts.places_missed(content.arm_improved)
    return figures


def diagnosis_figures(diagnosis: DiagnosisContent) -> dict[str, Figure]:
    """Figures of a diagnosis: evidence map, response curves, differences along covariates; each joint of each channel of a motion."""
    figures: dict[str, Figure] = {}
    if diagnosis.evidence_map is not None:
        figures["evidence_map"] = diagnosis_charts.evidence_map(*diagnosis.evidence_map)
    figures |= {f"response_{k}": diagnosis_charts.response_curve(curve) for k, curve in enumerate(diagnosis.curves)}
    if centres := diagnosis.centres:
        figures |= {f"along_{k}": diagnosis_charts.difference_along(centres, c) for k, c in enumerate(diagnosis.covariates)}
    return figures | {
        f"motion_{series.channel}_{series.at}": motion_charts.channel_over_time(series, kind.quantity, kind.unit)
        for kind in diagnosis.kinds
        for series in kind.series
    }


def fleet_figures(fleet: FleetContent) -> dict[str, Figure]:
    """Figures of a fleet, for each type of arm: overview, drift over time, arms beside each other."""
    figures: dict[str, Figure] = {}
    for k, kind in enumerate(fleet.types):
        if kind.charts:
            figures |= {f"drift_{k}": fleet_charts.drift(kind), f"arms_{k}": fleet_charts.side_by_side(kind)}
            if any(np.isfinite(chart.limit).any() for chart in kind.charts):
                figures[f"overview_{k}"] = fleet_charts.overview(kind)
    return figures


def _residual_figures(residuals: Residuals) -> dict[str, Figure]:
    used = residuals.used()
    figures: dict[str, Figure] = {
        "pose": residual_charts.residual_per_pose(residuals),
        "ball": residual_charts.residual_per_ball(used),
        "ball_mean": residual_charts.residual_mean_per_ball(used),
    }
    if used.station is not None and len(set(used.station)) > 1:
        figures["station"] = residual_charts.residual_per_station(used, used.station)
    if used.q_deg is not None:
        figures |= {f"axis_{i}": residual_charts.residual_over_axis(used, used.q_deg, i) for i in range(used.q_deg.shape[1])}
    if used.weighted is not None:
        figures["histogram"] = residual_charts.histogram(used.weighted)
    return figures


def _coverage_figures(coverage: Coverage) -> dict[str, Figure]:
    figures: dict[str, Figure] = {} if coverage.q_deg is None else {"joints": workspace_charts.joint_coverage(coverage)}
    if coverage.flange is None:
        return figures
    xyz, phase = coverage.flange, coverage.phase
    if coverage.balls is not None and coverage.ball_phase is not None:
        xyz, phase = coverage.balls, coverage.ball_phase
    views = {"places_top": 1, "places_side": 2}
    return figures | {name: workspace_charts.position_coverage(xyz, phase, axis) for name, axis in views.items()}


def _device_figures(devices: Devices) -> dict[str, Figure]:
    figures: dict[str, Figure] = {}
    if devices.state_s:
        figures["states"] = device_charts.time_spent(devices.state_s)
    if devices.late is not None and devices.late.any():
        figures["late"] = device_charts.late_answers(devices.late)
    if devices.period_ms is not None and len(devices.period_ms):
        figures["period"] = device_charts.periods(devices.period_ms, devices.nominal_ms)
    if devices.exposure_s is not None and len(devices.exposure_s):
        figures["exposure"] = device_charts.exposure_times(devices.exposure_s)
    return figures
