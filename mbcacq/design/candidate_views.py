"""Many reachable, collision-free views of the artefacts at their stations, for a design to choose from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.clearance import Clearance
from mbcacq.plan.expansion_targets import aims, seen
from mbcacq.plan.field_of_view import T_base_scanner
from mbcacq.plan.ik_selection import DEFAULT_SPEED, cheapest
from mbcacq.plan.kinematics import InverseKinematics
from mbcacq.plan.occlusion import STEEPEST, occluded
from mbcacq.plan.schema import View

LIMIT_MARGIN = np.radians(4.0)
SINGULAR = np.radians(8.0)
SHIFTS = np.array([16.0, 24.0, 20.0])  # mm, largest
FEWEST = 4  # balls that a view must show, or all where there are fewer


@dataclass(frozen=True)
class CandidateView:
    """A view of a station with the pose it leads to."""

    station: str
    aim: int | None  # the ball looked at by itself, None for all together
    view: View
    pose: PlannedPose


def random_views(count: int, steepest_deg: float, rng: np.random.Generator) -> list[View]:
    """On a grid coarse enough to be written down: whole degrees and millimetres, both wrist branches alike."""
    # Uniform over the cap of directions, not over the angle.
    tilt = np.degrees(np.arccos(1 - rng.uniform(0, 1, count) * (1 - np.cos(np.radians(steepest_deg)))))
    azimuth, roll = rng.integers(-36, 36, (2, count)) * 5
    shift = np.rint(rng.uniform(-1, 1, (count, 3)) * SHIFTS)
    return [
        View(
            tilt_deg=float(np.rint(t)),
            azimuth_deg=float(a),
            roll_deg=float(r),
            shift_mm=tuple(map(float, s)),
            wrist="positive" if k % 2 else "negative",
        )
        for k, (t, a, r, s) in enumerate(zip(tilt, azimuth, roll, shift, strict=True))
    ]


def candidates(loaded: LoadedPlan, stations: list[str], per_station: int, steepest_deg: float, seed: int) -> list[CandidateView]:
    """Random views that can be taken: within the limits less a margin, wrist bent, enough balls in view and not hidden, nothing near."""
    rng = np.random.default_rng(seed)
    solver, clearance = InverseKinematics.of(loaded.cell.robot), Clearance(loaded)
    out: list[CandidateView] = []
    for station in stations:
        single = single_aims(loaded, station)
        for aim in single:
            views = random_views(per_station // len(single), min(steepest_deg, np.degrees(STEEPEST)), rng)
            out += _at_station(loaded, station, aim, views, solver, clearance)
    return out


def single_aims(loaded: LoadedPlan, station: str) -> list[int | None]:
    """The balls to be looked at one by one where the artefact is longer than the view is wide, else None for all together."""
    artefact = loaded.cell.artefact(next(s for s in loaded.cell.stations if s.id == station).artefact)
    size = np.linalg.norm(artefact.centres[:, None] - artefact.centres, axis=2).max()
    return list(artefact.ball_ids) if size > 2 * max(loaded.plan.scanner.field_of_view.far_half_mm) else [None]


def _at_station(
    loaded: LoadedPlan, station: str, aim: int | None, views: list[View], solver: InverseKinematics, clearance: Clearance
) -> list[CandidateView]:
    cell, robot = loaded.cell, loaded.cell.robot
    place = next(s for s in cell.stations if s.id == station)
    artefact = cell.artefact(place.artefact)
    point = aims(artefact, "all" if aim is None else (aim,))[0]
    fewest = min(FEWEST, len(artefact.ball_ids)) if aim is None else 1
    T_base_scanners = np.stack([T_base_scanner(place.T_base_station, point, v) for v in views])
    flanges = T_base_scanners @ se3.inverse(cell.T_flange_scanner)
    xyz = se3.apply(se3.inverse(T_base_scanners)[:, None] @ place.T_base_station, artefact.centres)
    speed = np.full(robot.n, DEFAULT_SPEED) if robot.speed is None else robot.speed
    home = np.radians(loaded.plan.robot.home_deg)
    out = []
    for view, flange, centres, found in zip(views, flanges, xyz, solver.solutions(flanges), strict=True):
        balls = seen(loaded, station, flange)
        found = found[(1 if view.wrist == "positive" else -1) * found[:, 4] >= 0]
        if len(balls) < fewest or not len(found):
            continue
        hidden = {artefact.ball_ids[b] for _, b in occluded(centres, artefact.diameters / 2, loaded.plan.scanner.field_of_view)}
        if hidden & set(balls):
            continue
        # The posture that the plan's expansion will take; where that one is poor, the view is left out.
        q = found[cheapest(home, [found], [False], robot, speed)[0]]
        if np.minimum(q - robot.limits[:, 0], robot.limits[:, 1] - q).min() < LIMIT_MARGIN or abs(q[4]) < SINGULAR:
            continue
        if clearance.at(q, station).distance < loaded.plan.clearance_mm + 5:
            continue
        out.append(
            CandidateView(
                station,
                aim,
                view,
                PlannedPose(
                    number=len(out),
                    step=0,
                    step_name="design",
                    phase="position",
                    station=station,
                    artefact=artefact.id,
                    q=q,
                    balls=balls,
                    exposures=loaded.plan.exposures,
                    line=0,
                ),
            )
        )
    return out
