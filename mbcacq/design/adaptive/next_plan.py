"""The chosen visits as a plan that runs by itself, or adds its poses to a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from mbcacq.design.adaptive.options import OPTIONS, AdaptiveOptions
from mbcacq.design.adaptive.places import accepted_places
from mbcacq.design.adaptive.pool import not_measured, reachable_views, routed, shortest_order
from mbcacq.design.adaptive.questions import differ_by_direction, differ_in_time
from mbcacq.design.adaptive.visit_choice import OpenPair, Visit, VisitChoice, VisitCosts
from mbcacq.design.plan_rewriter import seen_from
from mbcacq.diagnosis.findings import TOGETHER, Advice
from mbcacq.diagnosis.interim import InterimEvidence
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.model import yaml12
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand, load
from mbcacq.plan.feasibility import check
from mbcacq.quantities import in_degrees

DIGITS = 3  # of an angle in degrees: a hundredth of what arms repeat
MOST_NAMED = 3  # effects that a sentence names


@dataclass(frozen=True)
class NextPoses:
    """The visits that decide most of what a recording leaves open, in their order; none where nothing reachable would.

    Attributes
    ----------
    open_pairs : tuple[OpenPair, ...]
        Sets of effects that are not told apart.
    futile : bool
        Whether nothing that can be reached tells them apart.
    hidden : tuple[str, ...]
        Effects, as ``name:where``, that could still hide and that the visits show.
    shown : frozenset[str]
        Those that all that can be reached would show.
    """

    visits: tuple[Visit, ...]
    open_pairs: tuple[OpenPair, ...]
    futile: bool
    hidden: tuple[str, ...] = ()
    shown: frozenset[str] = frozenset()

    @property
    def poses(self) -> list[PlannedPose]:
        """The poses of all visits, in their order."""
        return [pose for visit in self.visits for pose in visit.poses]

    @property
    def reasons(self) -> list[str]:
        """A sentence about each pair that is to be told apart, or about what could still hide."""
        if self.open_pairs:
            return [pair_in_words(pair) for pair in self.open_pairs]
        named = ", ".join(effect_in_words(label) for label in self.hidden[:MOST_NAMED])
        return [f"these poses show what could still hide{f': {named}' if named else ''}"] if self.visits else []

    @property
    def advice(self) -> tuple[Advice, ...]:
        """One piece of advice for each visit."""
        why = "; ".join(self.reasons[:MOST_NAMED])
        out = []
        for v in self.visits:
            angles = tuple(tuple(in_degrees(p.q).round(DIGITS).tolist()) for p in v.poses)
            out.append(Advice(f"{why}: measure {len(v.poses)} poses at station {v.station}", angles))
        return tuple(out)


def set_in_words(labels: Sequence[str]) -> str:
    """A set of effects as a person reads it."""
    return TOGETHER.join(effect_in_words(label) for label in labels) or "no effect"


def pair_in_words(pair: OpenPair) -> str:
    """Sets that cannot be told apart yet, and whether anything within reach separates them; if nothing, what else would."""
    open_ = f"{set_in_words(pair.a)} and {set_in_words(pair.b)} are not told apart ({odds_in_words(pair.odds)})"
    if not pair.futile:
        return open_
    if pair.held >= OPTIONS.enough:
        return f"{open_}, nor by any view that can be taken: a long bar, or measured places of the stations, would do it"
    other = {label.partition(":")[2] for label in (*pair.a, *pair.b)}
    instrument = "an inclinometer on it" if any(at == "base" or at.startswith("station") for at in other) else "the torques of the motors"
    return f"{open_}, nor by any view that can be taken: {instrument} would say more"


def costs_of(loaded: LoadedPlan, measured: Observations | None, options: AdaptiveOptions = OPTIONS) -> VisitCosts:
    """Seconds of a pose and of moving an artefact, and where each artefact stands after the last measured pose."""
    plan, at = loaded.plan, {} if measured is None else moved_artefacts(measured)[1]
    pose_s = options.pose_s + plan.exposures * plan.scanner.scan_time_s
    by_hand = plan.positioner.driver == "manual"
    return VisitCosts(pose_s, options.move_by_hand_s if by_hand else options.move_by_positioner_s, at, options.look_s)


def moved_artefacts(measured: Observations) -> tuple[int, dict[str, str]]:
    """How often artefacts were moved while a recording was made, and the station at which each stands after it."""
    moves, at = 0, dict[str, str]()
    for k in measured.measuring_order:
        station = measured.cell.stations[measured.station[k]]
        moves += at.get(station.artefact) != station.id
        at[station.artefact] = station.id
    return moves, at


def choose_next(
    look: InterimEvidence,
    loaded: LoadedPlan,
    visits: int,
    poses: int,
    moves: int | None = None,
    views: Sequence[PlannedPose] | None = None,
    options: AdaptiveOptions = OPTIONS,
) -> NextPoses:
    """The next visits of stations of a plan after a look: poses that can be reached, seen and routed.

    visits, poses: at most so many; moves: of artefacts, at most so many; None for any number. views: to choose from; default all of the
    plan's own and random ones.
    """
    measured = look.problem.linear.obs
    pool = not_measured(reachable_views(loaded, 0, options) if views is None else views, measured, differ_in_time(look))
    costs = costs_of(loaded, measured, options)
    if moves is not None and moves < 1:
        pool = [p for p in pool if costs.at.get(p.artefact) == p.station]
    if not pool:
        return NextPoses((), (), True)
    choice = VisitChoice(look, pool, loaded.cell.stations, costs, options, accepted_places(loaded.plan.accept))
    if choice.futile:
        return NextPoses((), choice.open_pairs, True, (), choice.shown)
    most = visits if moves is None else max(min(visits, moves), 1)
    both_ways = differ_by_direction(look)
    count = poses // 2 + 1 if both_ways else poses
    found = [
        replace(v, poses=_approached(shortest_order(loaded, v.poses), both_ways))
        for v in choice.sequence(most, count, lambda pose: not routed(loaded, pose))
    ]
    return NextPoses(tuple(_feasible(loaded, found)), choice.open_pairs, False, tuple(choice.hidden(found)), choice.shown)


def advised(
    look: InterimEvidence,
    loaded: LoadedPlan,
    visits: int = OPTIONS.advised_visits,
    poses: int = OPTIONS.advised_poses,
    views: Sequence[PlannedPose] | None = None,
) -> NextPoses:
    """The same for a person, who measures all of it before the next look: as much as is expected to decide nine times in ten."""
    return choose_next(look, loaded, visits, poses, views=views, options=replace(OPTIONS, spare=OPTIONS.advised_spare))


def _approached(poses: list[PlannedPose], both_ways: bool) -> tuple[PlannedPose, ...]:
    """Measured forwards, and then backwards, so that every pose but the last is approached from two others."""
    return tuple([*poses, *reversed(poses[:-1])] if both_ways else poses)


def _feasible(loaded: LoadedPlan, visits: list[Visit]) -> list[Visit]:
    """The visits without the poses that a check of their plan finds wrong. A fault of no single pose, such as a bar that calibrates nothing
    by itself, is not counted: the poses extend a recording. The plan that has grown is checked as a whole before it is run.
    """
    while visits:
        text = next_plan_text(loaded, visits, loaded.path.parent)
        plan = load(loaded.path, text)
        wrong = {number for f in check(plan, expand(plan)) if f.level == "error" for number in f.poses}
        if not wrong:
            return visits
        number, left = 0, []
        for visit in visits:
            kept = tuple(p for k, p in enumerate(visit.poses) if number + k not in wrong)
            number += len(visit.poses)
            if kept:
                left.append(replace(visit, poses=kept))
        visits = left
    return []


def next_plan_text(loaded: LoadedPlan, visits: Sequence[Visit], folder: Path, reasons: Sequence[str] = ()) -> str:
    """YAML of a plan with these visits in the cell of another plan, to stand in a folder. Everything else is as in that plan."""
    data = yaml12.load(loaded.text)
    _moved_files(data, loaded.path.parent, folder)
    data["name"] = f"{data['name']}, next"
    data["steps"] = steps_of(loaded, visits)
    said = "".join(f"# {sentence}.\n" for sentence in ("Chosen to decide what a recording leaves open", *reasons))
    return said + yaml12.dump(data, allow_unicode=True, width=140, default_flow_style=None)


def steps_of(loaded: LoadedPlan, visits: Sequence[Visit], first: int = 1) -> list[dict[str, Any]]:
    """The steps of a plan that measure visits, by joint angles: just what was chosen and checked. A visit is one step, or one for each ball
    that is looked at by itself.
    """
    out = []
    for number, visit in enumerate(visits, first):
        runs = [(balls, list(some)) for balls, some in groupby(visit.poses, key=lambda p: _by_itself(loaded, p))]
        for part, (balls, poses) in enumerate(runs, 1):
            step: dict[str, Any] = {
                "name": f"visit {number}{f'.{part}' if len(runs) > 1 else ''}, {visit.station}",
                "phase": "position",
                "do": "joints",
                "station": int(visit.station) if visit.station.isdecimal() else visit.station,
                "poses_deg": [[float(a) for a in in_degrees(p.q).round(DIGITS)] for p in poses],
            }
            out.append(step if balls is None else {**step, "balls": list(balls)})
    return out


def _by_itself(loaded: LoadedPlan, pose: PlannedPose) -> tuple[int, ...] | None:
    """The balls that a pose looks at, where these are fewer than a view of the whole artefact must show."""
    whole = len(loaded.cell.artefact(pose.artefact).ball_ids)
    return pose.balls if len(pose.balls) < min(loaded.plan.accept.min_balls, whole) else None


def _moved_files(data: dict[str, Any], before: Path, folder: Path) -> None:
    """Names of files, which are relative to a plan, as seen from another folder."""
    if before.resolve() == folder.resolve():
        return
    robot = data["robot"]
    for key in ("model", "urdf"):
        if robot.get(key) is not None:
            robot[key] = seen_from(folder, before / robot[key])
    data["artefacts"] = [seen_from(folder, before / name) for name in data["artefacts"]]
