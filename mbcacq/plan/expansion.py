"""A plan as the list of poses to take: its steps become targets, and each target the joint position to reach it with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.numerical_inverse import NumericalInverse
from mbcacq.model.cell import Artefact
from mbcacq.model.yaml_source import Path_
from mbcacq.plan.field_of_view import T_base_scanner, aim_depth, margin
from mbcacq.plan.ik_selection import select_solutions
from mbcacq.plan.inverse_kinematics import wrist_axis
from mbcacq.plan.planned import LoadedPlan, PlannedPose
from mbcacq.plan.routing import find_paths, router_of
from mbcacq.plan.schema import AnyStep, Look, ScanPart, Sweep, Taught, Translate, View
from mbcacq.quantities import DEGREE, from_degrees

SAME_POSTURE = 1e-6  # rad, full turns aside
LARGEST_SWEEP = 60.0 * DEGREE  # of an axis: more is no straight line of the tool any more


@dataclass(frozen=True)
class Target:
    """One pose to take.

    Attributes
    ----------
    T_base_flange : ndarray or None
        (4, 4), or ``q`` (n,) rad where the step gives joint angles; the other one is None.
    balls : tuple[int, ...]
        Ids expected in view.
    wrist : str
        Sign asked of the last axis but one.
    where : Path_
        Path of the view, offset or joint vector in the YAML.
    T_sweep_end : ndarray or None
        (4, 4), flange at the far end of a sweep that begins and ends at the pose.
    """

    step: int
    station: str
    T_base_flange: np.ndarray | None
    q: np.ndarray | None
    balls: tuple[int, ...]
    wrist: str
    where: Path_
    T_sweep_end: np.ndarray | None = None


def expand(loaded: LoadedPlan) -> list[PlannedPose]:
    """Every pose of the plan in running order, with joint angles.

    Raises ConfigError naming step and line of the first pose that cannot be reached.
    """
    poses, unreachable = expand_reachable(loaded)
    if unreachable:
        raise ConfigError(unreachable_sentence(loaded, unreachable[0]))
    return poses


def expand_reachable(loaded: LoadedPlan) -> tuple[list[PlannedPose], list[Target]]:
    """The poses that can be reached, and the targets that cannot."""
    poses, unreachable = loaded.computed("expansion", lambda: _expand(loaded))
    return list(poses), list(unreachable)


def _expand(loaded: LoadedPlan) -> tuple[list[PlannedPose], list[Target]]:
    wanted = targets(loaded)
    solutions = _solutions(loaded, wanted)
    reachable = [(t, q) for t, q in zip(wanted, solutions, strict=True) if len(q)]
    unreachable = [t for t, q in zip(wanted, solutions, strict=True) if not len(q)]
    stations = [t.station for t, _ in reachable]
    restart = [i > 0 and stations[i] != stations[i - 1] for i in range(len(stations))]
    chosen = _free_solutions(loaded, [t for t, _ in reachable], [q for _, q in reachable], restart)
    return _poses(loaded, [t for t, _ in reachable], chosen), unreachable


def _poses(loaded: LoadedPlan, wanted: list[Target], chosen: list[np.ndarray]) -> list[PlannedPose]:
    return [_planned(loaded, i, t, q) for i, (t, q) in enumerate(zip(wanted, chosen, strict=True))]


def _free_solutions(loaded: LoadedPlan, wanted: list[Target], options: list[np.ndarray], restart: list[bool]) -> list[np.ndarray]:
    """The joint position (n,) rad to take at each target. It is one of those that reach it (k, n) at which nothing is too close, if there
    is one. For an arm with many ways to a pose it is one with a free path to it. A position that fails is left out, with the same posture
    full turns away, and all are chosen anew."""
    router, needed = router_of(loaded), loaded.plan.clearance_mm
    many_ways = isinstance(router.solver, NumericalInverse)
    left, spoiled = list(options), [target.T_base_flange is None for target in wanted]

    @cache
    def too_close(i: int, q: tuple[float, ...]) -> bool:
        return router.clearance.at(np.array(q), wanted[i].station).distance < needed

    for _ in range(loaded.planning.selection_rounds):
        q = [of[k] for of, k in zip(left, select_solutions(loaded, left, restart), strict=True)]
        blocked = [i for i, here in enumerate(q) if not spoiled[i] and too_close(i, tuple(here.tolist()))]
        if not blocked and many_ways:
            obstructed = find_paths(loaded, _poses(loaded, wanted, q))[1]
            blocked = [o.number for o in obstructed if not spoiled[o.number]]
        if not blocked:
            return q
        for i in blocked:
            apart = np.abs(np.mod(left[i] - q[i] + np.pi, 2 * np.pi) - np.pi).max(axis=1) > SAME_POSTURE
            # Where every position is too close, the first choice stands and the checks of the plan say so.
            spoiled[i] = not apart.any()
            left[i] = options[i] if spoiled[i] else left[i][apart]
    return [of[k] for of, k in zip(left, select_solutions(loaded, left, restart), strict=True)]


def unreachable_sentence(loaded: LoadedPlan, target: Target) -> str:
    """'file:line: ...' about a target that no joint position reaches."""
    step = loaded.plan.steps[target.step]
    wrist = "" if target.wrist == "any" else f" with A{wrist_axis(loaded.cell.robot.n) + 1} {target.wrist}"
    return (
        f"{loaded.path}:{loaded.lines[target.where]}: step '{step.name}' at station '{target.station}': no joint position within the "
        f"limits of {loaded.cell.robot.name} reaches this pose{wrist}; move the station or change the view"
    )


def targets(loaded: LoadedPlan) -> list[Target]:
    """All targets of a plan in the order of its YAML: step by step, station by station, ball by ball, view by view."""
    return [target for index, step in enumerate(loaded.plan.steps) for target in _of_step(loaded, index, step)]


def visible_balls(loaded: LoadedPlan, station: str, T_base_flange: np.ndarray) -> tuple[int, ...]:
    """Balls of the artefact at a station that lie wholly in the field of view at a flange pose (4, 4)."""
    artefact = _artefact(loaded, station)
    T_base_station = loaded.cell.station(station).planned_pose
    xyz = se3.apply(se3.inverse(T_base_flange @ loaded.cell.T_flange_scanner) @ T_base_station, artefact.centres)
    inside = margin(loaded.plan.scanner.field_of_view, xyz, artefact.diameters / 2) >= 0
    return tuple(ball for ball, yes in zip(artefact.ball_ids, inside, strict=True) if yes)


def aim_points(artefact: Artefact, balls: str | tuple[int, ...]) -> np.ndarray:
    """(k, 3) mm points to look at: the middle of all balls, each ball, or certain ones."""
    if balls == "all":
        return artefact.centres.mean(axis=0)[None]
    return artefact.centres if balls == "each" else artefact.centres[[artefact.ball_ids.index(b) for b in balls]]


def _of_step(loaded: LoadedPlan, index: int, step: AnyStep) -> Iterator[Target]:
    if isinstance(step, Translate):
        centre = _artefact(loaded, str(step.station)).centres.mean(axis=0)
        for i, offset in enumerate(step.offsets_mm):
            yield _looking(loaded, str(step.station), centre, step.view, ("steps", index, "offsets_mm", i), offset)
    elif isinstance(step, Look):
        for station in map(str, step.stations):
            for centre in aim_points(_artefact(loaded, station), step.balls):
                for i, view in enumerate(step.views):
                    yield _looking(loaded, station, centre, view, ("steps", index, "views", i))
    elif isinstance(step, Sweep):
        yield from _swept(loaded, index, step)
    elif isinstance(step, ScanPart):
        yield from _scanned(loaded, index, step)
    else:
        yield from _taught(loaded, index, step)


def _scanned(loaded: LoadedPlan, index: int, step: ScanPart) -> Iterator[Target]:
    """Views of a part, which has no balls."""
    for station in map(str, step.stations):
        box = _artefact(loaded, station).box
        assert box is not None, "the loader takes parts only"
        top = np.append(box[:, :2].mean(axis=0), box[1, 2])
        for i, view in enumerate(step.views):
            point = top if view.at_mm is None else np.array(view.at_mm)
            yield _looking(loaded, station, point, view, ("steps", index, "views", i))


def _swept(loaded: LoadedPlan, index: int, step: Sweep) -> Iterator[Target]:
    """Lines through each ball, which the laser plane (y = 0 of the scanner) crosses in their middle."""
    for station in map(str, step.stations):
        artefact = _artefact(loaded, station)
        for ball in artefact.ball_ids if step.balls == "each" else step.balls:
            centre = artefact.centres[artefact.ball_ids.index(ball)]
            for i, view in enumerate(step.views):
                middle = _looking(loaded, station, centre, view, ("steps", index, "views", i))
                assert middle.T_base_flange is not None, "a view gives it"
                scanner = middle.T_base_flange @ loaded.cell.T_flange_scanner
                for angle in from_degrees(step.directions_deg):
                    half = 0.5 * step.length_mm * scanner[:3, :3] @ np.array([np.sin(angle), np.cos(angle), 0.0])
                    begin, end = (se3.transform(np.eye(3), way * half) @ middle.T_base_flange for way in (-1.0, 1.0))
                    yield replace(middle, T_base_flange=begin, T_sweep_end=end, balls=(ball,))


def _taught(loaded: LoadedPlan, index: int, step: Taught) -> Iterator[Target]:
    station = str(step.station)
    for i, pose in enumerate(step.poses_deg):
        q = loaded.plan.robot.with_external(from_degrees(pose))
        balls = step.balls or visible_balls(loaded, station, loaded.cell.robot.chain.flange(q[None])[0])
        yield Target(index, station, None, q, balls, "any", ("steps", index, "poses_deg", i))


def _looking(
    loaded: LoadedPlan, station: str, point: np.ndarray, view: View, where: tuple[str, int, str, int], offset_mm=(0.0, 0.0, 0.0)
) -> Target:
    """Looks at ``point`` (3,) mm of the station frame, the scanner moved by an offset along the base axes."""
    depth = aim_depth(loaded.plan.scanner.field_of_view)
    scanner = T_base_scanner(loaded.cell.station(station).planned_pose, point, view, depth)
    scanner[:3, 3] += offset_mm
    flange = scanner @ se3.inverse(loaded.cell.T_flange_scanner)
    return Target(where[1], station, flange, None, visible_balls(loaded, station, flange), view.wrist, where)


def _solutions(loaded: LoadedPlan, wanted: list[Target]) -> list[np.ndarray]:
    """Per target the joint positions (k, n) rad that reach it, k may be 0; a taught one reaches itself."""
    solutions = [np.empty((0, 0)) if t.q is None else t.q[None] for t in wanted]
    free = [(i, t.wrist, t.T_base_flange) for i, t in enumerate(wanted) if t.T_base_flange is not None]
    if free:
        solver, wrist_bend = router_of(loaded).solver, wrist_axis(loaded.cell.robot.n)
        for (i, wrist, _), q in zip(free, solver.solutions(np.stack([T for *_, T in free])), strict=True):
            sign = {"any": 0, "positive": 1, "negative": -1}[wrist]
            solutions[i] = _nearest_home(loaded, _spread(loaded, i, q[sign * q[:, wrist_bend] >= 0]))
    return solutions


def _spread(loaded: LoadedPlan, number: int, q: np.ndarray) -> np.ndarray:
    """Those of the positions (k, n) that reach a target at which the axes to be spread are nearest to its share of their range, by the
    sequence of Halton (1960): any few in a row are spread over it."""
    axes = np.flatnonzero(loaded.plan.robot.is_spread)
    if not len(axes) or not len(q):
        return q
    low, high = loaded.cell.robot.limits[axes].T
    away = np.abs((q[:, axes] - low) / (high - low) - [_halton(number + 1, base) for base in HALTON[: len(axes)]]).sum(axis=1)
    return q[away <= away.min() + 1e-9]


HALTON = (2, 3, 5, 7, 11, 13)  # bases of the sequence, one an axis


def _halton(number: int, base: int) -> float:
    value, share = 0.0, 1.0 / base
    while number:
        number, digit = divmod(number, base)
        value, share = value + digit * share, share / base
    return value


def _nearest_home(loaded: LoadedPlan, q: np.ndarray) -> np.ndarray:
    """The joint positions (k, n) rad nearest to home, no more than planning looks at, in their order."""
    most, home = loaded.planning.most_positions, loaded.plan.robot.home
    unit = loaded.cell.robot.chain.by_kind(1.0, 2e-3)  # a track goes half a metre while an axis turns by 1 rad
    return q if len(q) <= most else q[np.sort(np.argsort((np.abs(q - home) * unit).sum(axis=1), kind="stable")[:most])]


def _planned(loaded: LoadedPlan, number: int, target: Target, q: np.ndarray) -> PlannedPose:
    step = loaded.plan.steps[target.step]
    end = None
    if target.T_sweep_end is not None:
        end = router_of(loaded).solver.nearest(target.T_sweep_end, q)
        if end is None or np.abs(end - q).max() > LARGEST_SWEEP:
            raise ConfigError(unreachable_sentence(loaded, target))
    return PlannedPose(
        number=number,
        step=target.step,
        step_name=step.name,
        phase=step.phase,
        station=target.station,
        artefact=loaded.cell.station(target.station).artefact,
        q=q,
        balls=target.balls,
        exposures=step.exposures or loaded.plan.exposures,
        line=loaded.lines[target.where],
        sweep=end,
    )


def _artefact(loaded: LoadedPlan, station: str) -> Artefact:
    return loaded.cell.artefact(loaded.cell.station(station).artefact)
