"""Optimal experiment design: better poses for a plan, chosen by what they determine of the arm, from many that can be taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbcacq.design.candidate_views import candidates
from mbcacq.design.design_problem import DesignProblem
from mbcacq.design.exchange_algorithm import choose_by_exchange
from mbcacq.design.options import OPTIONS
from mbcacq.design.plan_rewriter import Chosen, by_station, with_views
from mbcacq.design.station_repair import repaired
from mbcacq.errors import ConfigError
from mbcacq.plan import LoadedPlan, PlannedPose, expand
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.schema import Look


@dataclass(frozen=True)
class Design:
    """A plan that an optimal design has chosen.

    Attributes
    ----------
    text : str
        YAML of the new plan.
    chosen : Chosen
        Its views by station and ball (None: all).
    tried : int
        How many candidates there were.
    repairs : tuple[str, ...]
        A sentence about each thing of the given plan that could not be reached and was changed.
    """

    text: str
    chosen: Chosen
    tried: int
    repairs: tuple[str, ...] = ()


def design(loaded: LoadedPlan, count: int, *, criterion: str = "A", steepest_deg: float = 40.0, seed: int = 0) -> Design:
    """Replace the plan's 'position' poses by ``count`` others at the same stations; the poses of its other phases stay and count.

    criterion: 'A' (mean variance of the certified distances at the verification poses; without such, of points all over the reach) or
    'D' (volume of the parameters' confidence region). Raises ConfigError if the plan has no station to choose poses at, or fewer
    poses can be taken.
    """
    loaded, repairs = repaired(loaded)
    poses = expand_reachable(loaded)[0] if any(isinstance(s, Look) and s.phase == "position" for s in loaded.plan.steps) else expand(loaded)
    stations = _stations(loaded, poses)
    found = candidates(loaded, stations, steepest_deg, seed, OPTIONS)
    if len(found) < count:
        drawn = OPTIONS.views_per_station * len(stations)
        tried = f"of about {drawn} random views at {len(stations)} stations only {len(found)} can be taken"
        raise ConfigError(f"{loaded.path}: {tried}, fewer than the {count} asked for; move the stations, or ask for fewer")
    kept = [p for p in poses if p.phase in ("translation", "orientation")]
    problem = DesignProblem(loaded, kept, found, poses)
    picked = choose_by_exchange(problem.base, problem.blocks, problem.groups, count, problem.criterion(criterion))
    chosen = by_station([found[k] for k in picked], stations)
    return Design(with_views(loaded, chosen), chosen, len(found), tuple(repairs))


def _stations(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> list[str]:
    """Where the plan's position poses are, or, without such, every station of an artefact with at least three balls."""
    own = list(
        dict.fromkeys(str(s) for step in loaded.plan.steps if isinstance(step, Look) and step.phase == "position" for s in step.stations)
    )
    own = own or list(dict.fromkeys(p.station for p in poses if p.phase == "position"))
    rich = [s.id for s in loaded.cell.stations if len(loaded.cell.artefact(s.artefact).ball_ids) >= 3]
    stations = own or rich
    if not stations:
        raise ConfigError(f"{loaded.path}: there is no station of an artefact with at least three balls to choose poses at; add one")
    return stations
