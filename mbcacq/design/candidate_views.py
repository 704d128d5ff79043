"""Many reachable, collision-free views of the artefacts at their stations, for a design to choose from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.design.options import DesignOptions
from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.clearance import clearance_of
from mbcacq.plan.expansion import aim_points
from mbcacq.plan.field_of_view import T_base_scanner, aim_depth, margin
from mbcacq.plan.ik_selection import cheapest_from_home, wrist_bend
from mbcacq.plan.inverse_kinematics import inverse_kinematics, wrist_axis
from mbcacq.plan.occlusion import occluded
from mbcacq.plan.schema import View
from mbcacq.quantities import from_degrees, in_degrees

AT_ONCE = 250  # views whose postures are looked for together: many share the cost of a call, more of them memory


@dataclass(frozen=True)
class CandidateView:
    """A view of a station with the pose it leads to."""

    station: str
    aim: int | None  # the ball looked at by itself, None for all together
    view: View
    pose: PlannedPose


def random_views(count: int, steepest_deg: float, rng: np.random.Generator, options: DesignOptions | None = None) -> list[View]:
    """Views on a grid coarse enough to be written down: whole degrees and millimetres, both wrist branches alike."""
    # Uniform over the cap of directions, not over the angle.
    tilt = in_degrees(np.arccos(1 - rng.uniform(0, 1, count) * (1 - np.cos(from_degrees(steepest_deg)))))
    azimuth, roll = rng.integers(-36, 36, (2, count)) * 5.0
    shift = np.rint(rng.uniform(-1, 1, (count, 3)) * np.array((options or DesignOptions()).shifts_mm))
    drawn = enumerate(zip(np.rint(tilt).tolist(), azimuth.tolist(), roll.tolist(), shift.tolist(), strict=True))
    wrists = ("negative", "positive")  # in turn
    return [View(tilt_deg=t, azimuth_deg=a, roll_deg=r, shift_mm=tuple(s), wrist=wrists[k % 2]) for k, (t, a, r, s) in drawn]


def candidates(
    loaded: LoadedPlan, stations: list[str], steepest_deg: float, seed: int, options: DesignOptions | None = None
) -> list[CandidateView]:
    """Random views that can be taken: within the limits less a margin, wrist bent, enough balls in view and not hidden, nothing near."""
    options, rng = options or DesignOptions(), np.random.default_rng(seed)
    choice = ViewChoice(loaded, options)
    steepest_deg = min(steepest_deg, in_degrees(loaded.planning.steepest_view))
    seen: list[SeenView] = []
    for station in stations:
        single = single_aims(loaded, station)
        for aim in single:
            seen += choice.seen(station, aim, random_views(options.views_per_station // len(single), steepest_deg, rng, options))
    return [c for k in range(0, len(seen), AT_ONCE) for c in choice.taken(seen[k : k + AT_ONCE])]


def single_aims(loaded: LoadedPlan, station: str) -> list[int] | list[None]:
    """The balls to be looked at one by one where the artefact is longer than the view is wide, else None for all together."""
    artefact = loaded.cell.artefact(loaded.cell.station(station).artefact)
    size = np.linalg.norm(artefact.centres[:, None] - artefact.centres, axis=2).max()
    return list(artefact.ball_ids) if size > 2 * max(loaded.plan.scanner.field_of_view.far_half_mm) else [None]


@dataclass(frozen=True)
class SeenView:
    """A view that shows enough balls, with the flange's pose (4, 4) and the balls in view."""

    station: str
    aim: int | None
    view: View
    flange: np.ndarray
    balls: tuple[int, ...]


class ViewChoice:
    """Keeps of many views those that can be taken."""

    def __init__(self, loaded: LoadedPlan, options: DesignOptions) -> None:
        self._loaded, self._options = loaded, options
        self._solver, self._clearance = inverse_kinematics(loaded.cell.robot, sampled=True), clearance_of(loaded)

    def seen(self, station: str, aim: int | None, views: list[View]) -> list[SeenView]:
        """The ``views`` of one ball, or of all (None), that show enough balls, none of them hidden."""
        cell, planning, field = self._loaded.cell, self._loaded.planning, self._loaded.plan.scanner.field_of_view
        T_base_station = cell.station(station).planned_pose
        artefact = cell.artefact(cell.station(station).artefact)
        ids, radii = np.array(artefact.ball_ids), artefact.diameters / 2
        point = aim_points(artefact, "all" if aim is None else (aim,))[0]
        fewest = min(self._options.fewest_balls, len(ids)) if aim is None else 1
        T_base_scanners = np.stack([T_base_scanner(T_base_station, point, v, aim_depth(field)) for v in views])
        flanges = T_base_scanners @ se3.inverse(cell.T_flange_scanner)
        xyz = se3.apply(se3.inverse(T_base_scanners)[:, None] @ T_base_station, artefact.centres)
        inside = margin(field, xyz, radii) >= 0
        out = []
        for k in np.flatnonzero(inside.sum(axis=1) >= fewest):
            hidden = [behind for _, behind in occluded(xyz[k], radii, field, planning.hidden_share)]
            if not inside[k, hidden].any():
                out.append(SeenView(station, aim, views[k], flanges[k], tuple(ids[inside[k]].tolist())))
        return out

    def taken(self, seen: list[SeenView]) -> list[CandidateView]:
        """The views that the arm can take."""
        postures = [(v, q) for v, q in zip(seen, self.postures(seen), strict=True) if q is not None]
        return [CandidateView(v.station, v.aim, v.view, self._pose(k, v.station, q, v.balls)) for k, (v, q) in enumerate(postures)]

    def postures(self, seen: list[SeenView]) -> list[np.ndarray | None]:
        """The position by which the plan's expansion will reach each view, or None where that one is poor."""
        loaded, robot, options = self._loaded, self._loaded.cell.robot, self._options
        sign = [{"positive": 1, "negative": -1, "any": 0}[v.view.wrist] for v in seen]
        reached = self._solver.solutions(np.stack([v.flange for v in seen])) if seen else []
        found = [q[s * q[:, wrist_axis(robot.n)] >= 0] for s, q in zip(sign, reached, strict=True)]
        chosen = [q[k] if len(q) else None for q, k in zip(found, cheapest_from_home(loaded, found), strict=True)]
        return [None if q is None or self._is_poor(q, v.station, options) else q for v, q in zip(seen, chosen, strict=True)]

    def _is_poor(self, q: np.ndarray, station: str, options: DesignOptions) -> bool:
        loaded, robot = self._loaded, self._loaded.cell.robot
        near_limit = np.minimum(q - robot.limits[:, 0], robot.limits[:, 1] - q).min() < options.limit_margin
        if near_limit or wrist_bend(robot.chain, q[None])[0] < options.wrist_bend:
            return True
        return self._clearance.at(q, station).distance < loaded.plan.clearance_mm + options.spare_clearance_mm

    def _pose(self, number: int, station: str, q: np.ndarray, balls: tuple[int, ...]) -> PlannedPose:
        artefact, exposures = self._loaded.cell.station(station).artefact, self._loaded.plan.exposures
        return PlannedPose(number, 0, "design", "position", station, artefact, q, balls=balls, exposures=exposures, line=0)
