"""Does the scanner see what it shall: field of view, one ball before another, and from which side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbcacq.geometry import se3
from mbcacq.plan.field_of_view import margin
from mbcacq.plan.findings import PlanFinding, finding
from mbcacq.plan.planned import LoadedPlan, PlannedPose

STEEPEST = np.radians(70.0)  # between the scanner's axis and the artefact's: more, and it looks at the plate's edge
HIDDEN = 0.6  # of the sum of two radii: seen closer together than that, the far ball shows too little


def check_sight(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Iterator[PlanFinding]:
    plan, cell = loaded.plan, loaded.cell
    for pose in poses:
        place = next(s for s in cell.stations if s.id == pose.station)
        artefact = cell.artefact(pose.artefact)
        T_base_scanner = cell.robot.chain.flange(pose.q[None])[0] @ cell.T_flange_scanner
        T_scanner_station = se3.inverse(T_base_scanner) @ place.T_base_station
        xyz = se3.apply(T_scanner_station, artefact.centres)
        room = margin(plan.scanner.field_of_view, xyz, artefact.diameters / 2)
        expected = np.isin(artefact.ball_ids, pose.balls)
        lost = np.flatnonzero(expected & (room < 0))
        if len(lost):
            sentence = f"ball {artefact.ball_ids[lost[0]]} lies {-room[lost[0]]:.0f} mm outside the field of view; change view or shift_mm"
            yield finding(loaded, pose, "error", "out-of-view", sentence)
        fewest = min(plan.accept.min_balls, 1 if _by_ball(plan, pose) else len(artefact.ball_ids))
        if expected.sum() < fewest:
            seen = f"{expected.sum()} of {len(artefact.ball_ids)} balls are in view"
            sentence = f"{seen}, fewer than the {fewest} that are needed; change view or shift_mm"
            yield finding(loaded, pose, "error", "out-of-view", sentence)
        elif expected.sum() < len(artefact.ball_ids) and not _by_ball(plan, pose):
            yield finding(loaded, pose, "info", "part-view", f"{expected.sum()} of {len(artefact.ball_ids)} balls are in view")
        if np.arccos(np.clip(T_scanner_station[2, 2], -1, 1)) > STEEPEST:
            yield finding(loaded, pose, "warning", "steep", "the scanner looks at the artefact's edge; tilt it less, or turn the artefact")
        for front, behind in occluded(xyz, artefact.diameters / 2, plan.scanner.field_of_view):
            if expected[behind]:
                sentence = f"ball {artefact.ball_ids[front]} stands in front of ball {artefact.ball_ids[behind]}; change azimuth or tilt"
                yield finding(loaded, pose, "warning", "occluded", sentence)


def occluded(xyz: np.ndarray, radius: np.ndarray, field) -> list[tuple[int, int]]:
    """Pairs (front, behind) of balls, xyz (B, 3) mm in the scanner frame, of which the front one hides much of the other."""
    camera = np.array([0.0, 0.0, _camera_height(field)])
    ray = xyz - camera
    distance = np.linalg.norm(ray, axis=1)
    direction = ray / distance[:, None]
    aside = np.linalg.norm(np.cross(direction[:, None], ray[None]), axis=-1)  # [i, j]: ball j beside the ray to ball i
    front = distance[None] < distance[:, None]
    hides = front & (aside < HIDDEN * (radius[:, None] + radius[None]))
    np.fill_diagonal(hides, False)
    return [(int(j), int(i)) for i, j in zip(*np.nonzero(hides), strict=True)]


def _camera_height(field) -> float:
    """z (mm) where the sides of the frustum meet, the longer sides if they meet at different heights."""
    slope = (np.array(field.far_half_mm) - np.array(field.near_half_mm)) / (field.near_z_mm - field.far_z_mm)
    height = field.near_z_mm + np.array(field.near_half_mm) / np.maximum(slope, 1e-6)
    return float(min(height.max(), 1e5))


def _by_ball(plan, pose: PlannedPose) -> bool:
    step = plan.steps[pose.step]
    return getattr(step, "balls", None) not in (None, "all")
