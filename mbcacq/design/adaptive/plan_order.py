"""A better order for a plan: nested, so that its first poses are the best few of all sizes, in blocks that keep moves of artefacts few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbcacq.design.adaptive.backward_elimination import BackwardElimination, MeasuredInformation
from mbcacq.design.adaptive.next_plan import costs_of
from mbcacq.design.adaptive.options import OPTIONS
from mbcacq.design.adaptive.pool import routed
from mbcacq.design.adaptive.questions import Questions, questions
from mbcacq.design.candidate_views import CandidateView, candidates
from mbcacq.design.information_blocks import InformationBlocks
from mbcacq.design.options import DesignOptions
from mbcacq.design.plan_rewriter import by_station, position_step, with_position_steps
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.errors import ConfigError
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.expansion import aim_points, expand_reachable
from mbcacq.plan.schema import Look

AT_ONCE = 8  # poses that are left out together while there are twice as many as are wanted


@dataclass(frozen=True)
class PlanOrder:
    """A plan whose poses stand in the order of their information.

    Attributes
    ----------
    text : str
        YAML of the ordered plan.
    poses : int
        Number of chosen poses.
    blocks : tuple[int, ...]
        Number of poses in each block.
    shares : tuple[float, ...]
        Shares of the information (mean over all effects of log(1 + information)) of the whole given plan, that the poses up to the end of
        each block have.
    tried : int
        Number of poses to choose from.
    """

    text: str
    poses: int
    blocks: tuple[int, ...]
    shares: tuple[float, ...]
    tried: int


def ordered(loaded: LoadedPlan, count: int | None = None, steepest_deg: float = 40.0, seed: int = 0) -> PlanOrder:
    """The plan with its 'position' poses, or ``count`` better ones, in blocks of which each is the best continuation of those before it.

    The plan's poses and random views are reduced step by step: each step leaves out the one that is missed least. The measure is the
    information on all effects of the catalogue per second of motion, scan and artefact move. The poses of the other phases stay. Raises
    ConfigError where the plan has no 'position' step that looks at stations.
    """
    kept, own, drawn = _views(loaded, steepest_deg, seed)
    items = [*own, *drawn]
    count = min(count or len(own), len(items))
    blocks, asked, before = _information(loaded, kept, [item.pose for item in items])
    whole = asked.hidden(before.with_poses(blocks.select(np.arange(len(own)))).squares)
    rank = _elimination_order(loaded, [item.station for item in items], blocks, asked, before, count)
    sizes = [n for n in (OPTIONS.first_block, OPTIONS.second_block) if n < count] + [count]
    shares = [float(asked.hidden(before.with_poses(blocks.select(rank[:n])).squares) / max(whole, 1e-12)) for n in sizes]
    steps = []
    for number, (a, b) in enumerate(zip([0, *sizes[:-1]], sizes, strict=True), 1):
        steps += _steps_of_block(number, [items[k] for k in rank[a:b]], [s.id for s in loaded.cell.stations])
    lengths = tuple(b - a for a, b in zip([0, *sizes[:-1]], sizes, strict=True))
    return PlanOrder(with_position_steps(loaded, steps), count, lengths, tuple(shares), len(items))


def best_of_plan(loaded: LoadedPlan, count: int) -> list[PlannedPose]:
    """The ``count`` poses of a plan, those that judge it left out, that show most of all effects per second."""
    reachable, _ = expand_reachable(loaded)
    poses = [p for p in reachable if p.phase != "verification"]
    blocks, asked, before = _information(loaded, [], poses)
    rank = _elimination_order(loaded, [p.station for p in poses], blocks, asked, before, count)
    return [poses[k] for k in sorted(rank[:count].tolist())]


def _views(loaded: LoadedPlan, steepest_deg: float, seed: int) -> tuple[list[PlannedPose], list[CandidateView], list[CandidateView]]:
    """Poses that stay, and views among which is chosen: of the plan's 'position' steps, and random ones at their stations."""
    reachable, unreachable = expand_reachable(loaded)
    if unreachable:
        raise ConfigError(f"{loaded.path}: {len(unreachable)} poses cannot be reached; mbcacq plan check {loaded.path} names them")
    kept = [p for p in reachable if p.phase in ("translation", "orientation")]
    own = [view for index, step in enumerate(loaded.plan.steps) for view in _of_step(loaded, index, step, reachable)]
    if not own:
        raise ConfigError(f"{loaded.path}: there is no step 'do: look' of phase 'position' whose poses could be ordered; add one")
    stations = list(dict.fromkeys(view.station for view in own))
    aims = {view.station: view.aim is None for view in own}
    found = candidates(loaded, stations, steepest_deg, seed, DesignOptions(views_per_station=OPTIONS.views_of_order))
    drawn = [replace(c, pose=replace(c.pose, phase="position")) for c in found if aims[c.station] == (c.aim is None)]
    return kept, own, [view for view in drawn if routed(loaded, view.pose)]


def _of_step(loaded: LoadedPlan, index: int, step: Any, reachable: Sequence[PlannedPose]) -> list[CandidateView]:
    """The poses of a step that looks at stations, each with its view, in the order in which they are expanded."""
    if not isinstance(step, Look) or step.phase != "position":
        return []
    views = []
    for station in map(str, step.stations):
        artefact = loaded.cell.artefact(loaded.cell.station(station).artefact)
        aims = [None] if step.balls == "all" else artefact.ball_ids if step.balls == "each" else step.balls
        assert len(aims) == len(aim_points(artefact, step.balls)), "one aim for each point that is looked at"
        views += [(station, aim, view) for aim in aims for view in step.views]
    poses = [p for p in reachable if p.step == index]
    return [CandidateView(station, aim, view, pose) for (station, aim, view), pose in zip(views, poses, strict=True)]


def _information(
    loaded: LoadedPlan, kept: Sequence[PlannedPose], poses: Sequence[PlannedPose]
) -> tuple[InformationBlocks, Questions, MeasuredInformation]:
    """Blocks of the poses to choose from, and what the kept ones tell already, in the nominal cell."""
    every = [*kept, *poses]
    obs = planned_observations(loaded, [replace(p, number=k) for k, p in enumerate(every)])
    home = loaded.plan.robot.home
    obs = replace(obs, direction=np.sign(obs.q - home).astype(int))  # as if each were the first after home
    linear = LinearProblem.of(obs, planned_state(loaded))
    asked = questions(None, linear, timeless=True)
    blocks = InformationBlocks.of(linear, asked.columns, planned_noise(loaded, every), linear.keep)
    first = blocks.select(np.arange(len(kept)))
    before = MeasuredInformation.nothing(blocks.Z.shape[2], blocks.E.shape[2]).with_poses(first)
    return blocks.select(np.arange(len(kept), len(every))), asked, before


def _elimination_order(
    loaded: LoadedPlan, stations: Sequence[str], blocks: InformationBlocks, asked: Questions, before: MeasuredInformation, count: int
) -> np.ndarray:
    """Indices of all poses, at these stations, the one that was left out last first: what is missed least per second that is saved goes
    first. The poses of the first block have no order among themselves: so few that they hardly determine the geometry say little of each
    other but rounding.
    """
    elimination, costs = BackwardElimination(before, blocks, 0), costs_of(loaded, None)
    station = np.unique(stations, return_inverse=True)[1]
    gone = list[int]()
    while elimination.left.sum() > min(count, OPTIONS.first_block):
        index, _, missed = elimination.missed()
        loss = asked.hidden(elimination.squares) - asked.hidden(elimination.squares - missed)
        here = np.bincount(station[index])[station[index]]
        rate = loss / (costs.pose_s + costs.move_s / here)
        some = AT_ONCE if len(index) > 2 * count else 1
        for k in np.argsort(rate, kind="stable")[:some]:
            elimination.remove(int(index[k]))
            gone.append(int(index[k]))
    return np.array([*elimination, *gone[::-1]])


def _steps_of_block(number: int, views: Sequence[CandidateView], stations: Sequence[str]) -> list[dict[str, Any]]:
    """One step for each station and ball, station by station."""
    chosen = by_station(views, stations)
    return [position_step(f"block {number}, {station}", station, aim, some) for (station, aim), some in chosen.items()]
