"""Feasibility of a plan: what is wrong or doubtful in it, found before anything moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.plan.clearance import Closest, clearance_of
from mbcacq.plan.expansion import expand_reachable, unreachable_sentence
from mbcacq.plan.findings import PlanFinding, finding
from mbcacq.plan.motion_limits import axis_limits, requested_limits
from mbcacq.plan.occlusion import check_visibility
from mbcacq.plan.planned import LoadedPlan, PlannedPose
from mbcacq.plan.plausibility import lacks_orientation, symmetric
from mbcacq.plan.routing import Routes, find_paths, obstructed_sentence


def check(loaded: LoadedPlan, poses: Sequence[PlannedPose], routes: Routes | None = None) -> list[PlanFinding]:
    """Everything that is wrong with a plan whose reachable poses are ``poses``: reach, joints, view, clearance, routes. Never raises.

    routes: of ``find_paths``, where they are known already.
    """
    return [
        *check_artefacts(loaded),
        *check_motion_limits(loaded),
        *check_reach(loaded),
        *check_joints(loaded, poses),
        *check_visibility(loaded, poses),
        *check_clearance(loaded, poses),
        *check_routes(loaded, poses, routes),
        *check_repetition(loaded, poses),
        *check_revisits(loaded, poses),
    ]


def refuse_errors(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> None:
    """Raises ConfigError with the first error that ``check`` finds, and how many more there are."""
    errors = [f for f in check(loaded, poses) if f.level == "error"]
    if errors:
        more = f" ({len(errors) - 1} more: mbcacq plan check {loaded.path})" if len(errors) > 1 else ""
        raise ConfigError(f"{errors[0]}{more}")


def check_artefacts(loaded: LoadedPlan) -> Iterator[PlanFinding]:
    """Artefacts whose orientation no calibration can determine, and those that look the same turned."""
    if (found := lacks_orientation(loaded)) is not None:
        where, sentence = found
        yield PlanFinding(
            level="error",
            code="few-balls",
            step=loaded.plan.steps[int(where[1])].name,
            place=f"{loaded.path}:{loaded.lines.get(where, 1)}",
            sentence=sentence,
        )
    for index, artefact in enumerate(loaded.cell.artefacts):
        if sentence := symmetric(artefact):
            place = f"{loaded.path}:{loaded.lines.get(('artefacts', index), 1)}"
            yield PlanFinding(level="warning", code="symmetric", step="", place=place, sentence=sentence)


def check_motion_limits(loaded: LoadedPlan) -> Iterator[PlanFinding]:
    """Accelerations and jerks that the plan asks for and the arm does not allow."""
    wanted, allowed = requested_limits(loaded), axis_limits(loaded)
    robot = loaded.cell.robot
    for article, what, key, per in (("an", "acceleration", "acceleration_time_s", "/s²"), ("a", "jerk", "jerk_time_s", "/s³")):
        asked, limit = (robot.shown(getattr(limits, what)) for limits in (wanted, allowed))
        axis = int(np.argmax(asked / limit))
        if asked[axis] > limit[axis] * (1 + loaded.planning.limit_rounding):
            line = loaded.lines.get(("robot", key), loaded.lines.get(("robot",), 1))
            reached = f"{asked[axis]:.0f} {robot.unit(axis).strip()}{per}"
            sentence = f"{robot.axes[axis]} would get {article} {what} of {reached}, its limit is {limit[axis]:.0f}; raise {key}"
            yield PlanFinding(level="error", code="motion-limits", step="", place=f"{loaded.path}:{line}", sentence=sentence)


def check_reach(loaded: LoadedPlan) -> Iterator[PlanFinding]:
    """Targets that no joint position reaches."""
    for target in expand_reachable(loaded)[1]:
        place, sentence = unreachable_sentence(loaded, target).split(": ", 1)
        yield PlanFinding(level="error", code="reach", step=loaded.plan.steps[target.step].name, place=place, sentence=sentence)


def check_joints(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Iterator[PlanFinding]:
    """Limits and their margin, wrist, elbow and shoulder singularities."""
    robot = loaded.cell.robot
    for pose in poses:
        ends = np.array([pose.q if pose.sweep is None else pose.sweep, pose.q])
        room = np.minimum(ends - robot.limits[:, 0], robot.limits[:, 1] - ends).min(axis=0)
        axis = int(np.argmin(room))
        angle = robot.shown(ends[np.argmin(np.minimum(ends - robot.limits[:, 0], robot.limits[:, 1] - ends)[:, axis])])[axis]
        low, high = robot.shown(robot.limits.T)[:, axis]
        limits, at = f"its limits {low:g}..{high:g}{robot.unit(axis)}", f"{robot.axes[axis]} at {angle:.1f}{robot.unit(axis)}"
        if room[axis] < 0:
            yield finding(loaded, pose, "error", "limits", f"{at} exceeds {limits}; take another pose")
        elif room[axis] < loaded.planning.near_limit and axis >= robot.external:  # a track is at its end where the plan puts it
            yield finding(loaded, pose, "warning", "near-limit", f"{at} comes close to {limits}; another tilt, azimuth or roll keeps away")
        for code, sentence in _singularities(loaded, pose.q):
            yield finding(loaded, pose, "warning", code, sentence)


def _singularities(loaded: LoadedPlan, q: np.ndarray) -> Iterator[tuple[str, str]]:
    """Code and sentence of each singularity that a posture (n,) rad of a six-axis arm comes close to."""
    robot, nearest = loaded.cell.robot, np.sin(loaded.planning.singular_angle)
    if robot.n != 6:
        return
    frames = robot.chain.frames(q[None])[0]
    z, origin = frames[:, :3, 2], frames[:, :3, 3]
    if np.linalg.norm(np.cross(z[3], z[5])) < nearest:
        yield (
            "wrist-singular",
            "the wrist is almost straight: A4 and A6 turn about one line, and this pose hardly separates their errors; tilt more",
        )
    shoulder, elbow, wrist = origin[1], origin[2], origin[4]
    upper, lower = elbow - shoulder, wrist - elbow
    if np.linalg.norm(np.cross(upper, lower)) < nearest * np.linalg.norm(upper) * np.linalg.norm(lower):
        yield (
            "elbow-singular",
            "the arm is almost stretched: it is slow to move outwards and close to the end of its reach; bring the station nearer",
        )
    axis = z[0] / np.linalg.norm(z[0])
    if np.linalg.norm(np.cross(wrist - origin[0], axis)) < loaded.planning.shoulder_singular_mm:
        yield "shoulder-singular", "the wrist stands above axis A1: small moves sideways turn the whole arm; move the station outwards"


def check_clearance(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Iterator[PlanFinding]:
    """Distances at the poses and at home."""
    clearance, needed = clearance_of(loaded), loaded.plan.clearance_mm
    near = clearance.at(loaded.plan.robot.home, None)
    if near.distance < needed:
        place = f"{loaded.path}:{loaded.lines.get(('robot', 'home_deg'), 1)}"
        yield PlanFinding(
            level="error", code="collision", step="", place=place, sentence=f"at home {_proximity(near)}; choose another home position"
        )
    for pose in poses:
        near = clearance.at(pose.q, pose.station)
        if near.distance < needed:
            yield finding(
                loaded, pose, "error", "collision", f"at pose {pose.number} {_proximity(near)}; change the view, or move the station"
            )


def check_routes(loaded: LoadedPlan, poses: Sequence[PlannedPose], routes: Routes | None = None) -> Iterator[PlanFinding]:
    """Poses to or from which no free path was found; those that collide by themselves are found by ``check_clearance``."""
    _, obstructed = find_paths(loaded, poses) if routes is None else routes
    if not obstructed:
        return
    clearance, needed = clearance_of(loaded), loaded.plan.clearance_mm
    spoiled = {p.number for p in poses if clearance.at(p.q, p.station).distance < needed}
    by_number = {p.number: (before, p) for before, p in zip([None, *poses], poses, strict=False)}
    for each in obstructed:
        before, pose = by_number[each.number]
        if pose.number in spoiled or (before is not None and before.number in spoiled and not each.homewards):
            continue
        sentence = obstructed_sentence(loaded, poses, each).split(": ", 1)[1]
        yield PlanFinding(
            level="error", code="way", step=pose.step_name, place=f"{loaded.path}:{pose.line}", sentence=sentence, poses=(pose.number,)
        )


def check_repetition(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Iterator[PlanFinding]:
    """The same joint position twice at a station: the second one adds little."""
    taken: list[tuple[str, np.ndarray]] = []
    for pose in (p for p in poses if p.sweep is None):
        if any(s == pose.station and np.abs(q - pose.q).max() < loaded.planning.repeated_pose for s, q in taken):
            yield finding(loaded, pose, "warning", "repeated", "this pose was taken already at this station; take another view")
        taken.append((pose.station, pose.q))


def check_revisits(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> Iterator[PlanFinding]:
    """A station stands for one place of the artefact. Put back by hand, it stands elsewhere by more than the arm's repeatability."""
    if loaded.plan.positioner.driver != "manual":
        return
    stands: dict[str, str] = {}
    visited: set[str] = set()
    for pose in poses:
        if pose.station in visited and stands[pose.artefact] != pose.station:
            yield finding(
                loaded,
                pose,
                "warning",
                "revisited",
                "the artefact was taken away meanwhile and will not stand where it stood; "
                "give the second visit a station of its own, at the same place",
            )
        visited.add(pose.station)
        stands[pose.artefact] = pose.station


def _proximity(near: Closest) -> str:
    how = f"comes within {near.distance:.0f} mm of" if near.distance > 0 else f"runs {-near.distance:.0f} mm into"
    return f"{near.b} {how} {near.a}"
