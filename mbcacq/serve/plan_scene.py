"""A plan in 3D, as plain data for the view that turns: the arm in each pose, what its scanner sees there, and what stands around."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.link_shapes import arm_outline, link_radii
from mbcacq.plan import LoadedPlan, PlannedPose, load
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.schema import FieldOfView
from mbcacq.recording.run_folder.register import CHECK_RESULT
from mbcacq.recording.run_folder.run_plan import PLAN, fault_of, plan_of_run
from mbcacq.report.charts.style import PHASES
from mbcacq.report.sources.check_result import read_check_result

MOST_KEPT = 30
MOST_BYTES = 4 << 20  # of a plan
NOT_SEEN = "#8a929a"
LARGEST_BOX = 2000.0  # mm; a floor or a wall would only frame the scene, and make the arm small


class PlanScenes:
    """The scene of each run's plan as JSON, computed once at a time and kept until the plan changes. For several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[Path, tuple[int, str]] = {}

    def of(self, folder: Path) -> str:
        """Raises ConfigError if the plan is missing, damaged, or names files that are gone."""
        try:
            status = (folder / PLAN).stat()
        except OSError:
            raise ConfigError("this run has no plan: it was made of data from elsewhere") from None
        if status.st_size > MOST_BYTES:
            raise ConfigError(f"{folder / PLAN} is larger than any plan")
        with self._lock:
            kept = self._kept.get(folder)
            if kept is None or kept[0] != status.st_mtime_ns:
                kept = status.st_mtime_ns, json.dumps(plan_scene(plan_in(folder), _checked(folder)), allow_nan=False)
                self._kept[folder] = kept
                while len(self._kept) > MOST_KEPT:
                    del self._kept[next(iter(self._kept))]
        return kept[1]


def plan_in(folder: Path) -> LoadedPlan:
    """The plan that a run folder was recorded with. Nothing is restored where it is damaged. Raises ConfigError."""
    if fault := fault_of(folder, PLAN):
        raise ConfigError(f"{folder / PLAN} {fault}")
    return load(plan_of_run(folder), (folder / PLAN).read_text(encoding="utf-8"))


def _checked(folder: Path) -> frozenset[int] | None:
    """Numbers of the poses of a check; None if the folder is of no judged check: all poses of the plan count."""
    return frozenset(read_check_result(folder)["poses"]) if (folder / CHECK_RESULT).exists() else None


def plan_scene(loaded: LoadedPlan, only: frozenset[int] | None = None) -> dict[str, Any]:
    """What the view draws, mm in the base. only: numbers of the poses that are drawn; None: all.

    Returns
    -------
    dict
        'groups': balls of all stations, by artefact ('name', 'colour', 'points' (k, 3)). 'arm': (3 n, 3) corners of its links at home, with
        'radii' (n,). 'boxes': obstacles, corners (8, 3) each. 'poses': for each 'label', 'arm' (3 n + 1, 3) to the scanner, 'view' (8, 3)
        corners of the field of view, four near and four far, 'seen' (k, 3) the balls in it. 'colour' is that of its phase. 'unreachable':
        number of poses that the arm cannot take.
    """
    poses, lacking = expand_reachable(loaded)
    if only is not None:
        poses, lacking = [pose for pose in poses if pose.number in only], []
    cell, field = loaded.cell, loaded.plan.scanner.field_of_view
    centres = {s.id: se3.apply(s.T_base_station, cell.artefact(s.artefact).centres) for s in cell.stations if s.T_base_station is not None}
    points = [xyz for station in centres.values() for xyz in station]
    phases = list(dict.fromkeys(pose.phase for pose in poses))
    chain = cell.robot.chain
    boxes = [(np.array(o.min_mm, float), np.array(o.max_mm, float)) for o in loaded.plan.obstacles]
    return {
        "groups": [{"name": "balls at all stations, as planned", "colour": NOT_SEEN, "points": _rounded(points)}],
        "arm": _rounded(arm_outline(chain, loaded.plan.robot.home)),
        "radii": np.round(link_radii(chain), 1).tolist(),
        "boxes": [_rounded(_corners(low, high)) for low, high in boxes if np.max(high - low) <= LARGEST_BOX],
        "poses": [
            _pose(loaded, pose, f"{k} of {len(poses)}", field, centres, PHASES[phases.index(pose.phase) % len(PHASES)])
            for k, pose in enumerate(poses, 1)
        ],
        "unreachable": len(lacking),
    }


def _pose(
    loaded: LoadedPlan, pose: PlannedPose, place: str, field: FieldOfView, centres: dict[str, np.ndarray], colour: str
) -> dict[str, Any]:
    chain = loaded.cell.robot.chain
    T_base_scanner = chain.flange(pose.q[None])[0] @ loaded.cell.T_flange_scanner
    ids = loaded.cell.artefact(pose.artefact).ball_ids
    seen = [xyz for ball, xyz in zip(ids, centres.get(pose.station, ()), strict=False) if ball in pose.balls]
    names = ", ".join(map(str, pose.balls))
    return {
        "label": f"{place}: step {pose.step_name} ({pose.phase}), station {pose.station}, "
        f"sees {len(seen)} ball{'' if len(seen) == 1 else 's'}{f' ({names})' if seen else ''}",
        "arm": _rounded([*arm_outline(chain, pose.q), T_base_scanner[:3, 3]]),
        "view": _rounded(se3.apply(T_base_scanner, _frustum(field))),
        "seen": _rounded(seen),
        "colour": colour,
    }


def _frustum(field: FieldOfView) -> np.ndarray:
    """Corners (8, 3) of the field of view in the scanner frame: near, then far, each in turn around."""
    out = []
    for half, z in ((field.near_half_mm, field.near_z_mm), (field.far_half_mm, field.far_z_mm)):
        out += [(half[0] * x, half[1] * y, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.array(out, dtype=float)


def _corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Corners (8, 3) of a box in the order of ``_frustum``."""
    around = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.array([(x, y, z) for z in (low[2], high[2]) for x, y in around])


def _rounded(points: Any) -> list[list[float]]:
    return np.round(np.asarray(points, dtype=float).reshape(-1, 3), 1).tolist()
