"""What hides a ball from the scanner: the edge of its field of view, another ball, or a view from the side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbcacq.geometry import se3
from mbcacq.plan.field_of_view import margin
from mbcacq.plan.findings import PlanFinding, finding
from mbcacq.plan.planned import LoadedPlan, PlannedPose
from mbcacq.plan.schema import FieldOfView, Plan


def check_visibility(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Iterator[PlanFinding]:
    plan, cell = loaded.plan, loaded.cell
    for pose in (p for p in poses if p.sweep is None):  # a sweep shows its ball in the middle of its line
        artefact = cell.artefact(pose.artefact)
        if artefact.is_part:
            continue
        T_base_scanner = cell.robot.chain.flange(pose.q[None])[0] @ cell.T_flange_scanner
        T_scanner_station = se3.inverse(T_base_scanner) @ cell.station(pose.station).planned_pose
        xyz = se3.apply(T_scanner_station, artefact.centres)
        room = margin(plan.scanner.field_of_view, xyz, artefact.diameters / 2)
        expected = np.isin(artefact.ball_ids, pose.balls)
        lost = np.flatnonzero(expected & (room < 0))
        if len(lost):
            sentence = f"ball {artefact.ball_ids[lost[0]]} lies {-room[lost[0]]:.0f} mm outside the field of view; change view or shift_mm"
            yield finding(loaded, pose, "error", "out-of-view", sentence)
        fewest = min(plan.accept.min_balls, 1 if _by_ball(plan, pose) else len(artefact.ball_ids))
        if expected.sum() < fewest:
            in_view = f"{expected.sum()} of {len(artefact.ball_ids)} balls are in view"
            sentence = f"{in_view}, fewer than the {fewest} that are needed; change view or shift_mm"
            yield finding(loaded, pose, "error", "out-of-view", sentence)
        elif expected.sum() < len(artefact.ball_ids) and not _by_ball(plan, pose):
            yield finding(loaded, pose, "info", "part-view", f"{expected.sum()} of {len(artefact.ball_ids)} balls are in view")
        if np.arccos(np.clip(T_scanner_station[2, 2], -1, 1)) > loaded.planning.steepest_view:
            yield finding(loaded, pose, "warning", "steep", "the scanner looks at the artefact's edge; tilt it less, or turn the artefact")
        for front, behind in occluded(xyz, artefact.diameters / 2, plan.scanner.field_of_view, loaded.planning.hidden_share):
            if expected[behind]:
                sentence = f"ball {artefact.ball_ids[front]} stands in front of ball {artefact.ball_ids[behind]}; change azimuth or tilt"
                yield finding(loaded, pose, "warning", "occluded", sentence)


def occluded(xyz: np.ndarray, radius: np.ndarray, field: FieldOfView, hidden_share: float) -> list[tuple[int, int]]:
    """Pairs (front, behind) of balls, xyz (B, 3) mm in the scanner frame, of which the front one hides much of the other.

    hidden_share: of the sum of two radii (B,) mm; rays to two balls that pass closer together count as hidden.
    """
    camera = np.array([0.0, 0.0, camera_height(field)])
    ray = xyz - camera
    distance = np.linalg.norm(ray, axis=1)
    direction = ray / distance[:, None]
    aside = np.linalg.norm(se3.cross(direction[:, None], ray[None]), axis=-1)  # [i, j]: distance of ball j from the ray to ball i
    front = distance[None] < distance[:, None]
    hides = front & (aside < hidden_share * (radius[:, None] + radius[None]))
    np.fill_diagonal(hides, False)
    return [(int(j), int(i)) for i, j in zip(*np.nonzero(hides), strict=True)]


def camera_height(field: FieldOfView) -> float:
    """z (mm) where the sides of the frustum meet, the longer sides if they meet at different heights."""
    slope = (np.array(field.far_half_mm) - np.array(field.near_half_mm)) / (field.near_z_mm - field.far_z_mm)
    height = field.near_z_mm + np.array(field.near_half_mm) / np.maximum(slope, 1e-6)
    return float(min(height.max(), 1e5))


def _by_ball(plan: Plan, pose: PlannedPose) -> bool:
    """Whether the step of a pose looks at single balls."""
    step = plan.steps[pose.step]
    return getattr(step, "balls", None) not in (None, "all")
