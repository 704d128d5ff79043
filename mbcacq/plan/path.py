"""The way from pose to pose: straight in joint space where that is free, else by a detour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.plan import LoadedPlan, PlannedPose, Transit


def path(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> list[Transit]:
    """One transit a pose; where the station changes, by way of home, so that the artefact can be moved."""
    home = np.radians(loaded.plan.robot.home_deg)
    out = []
    for before, pose in zip([None, *poses[:-1]], poses, strict=True):
        moved = before is not None and before.station != pose.station
        out.append(Transit(leave=[home] if moved else []))
    return out
