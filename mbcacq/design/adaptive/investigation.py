"""The cell investigates itself: measure, weigh all explanations, choose the next visit of a station, until it knows.

The measuring side is handed in: a runner, a fake cell without protocols, somebody's own program. Decisions that were made before are
replayed and not made anew, so an interrupted investigation goes on as it would have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from mbcacq.calibration.description import likely_cause_named
from mbcacq.design.adaptive.first_block import first_block
from mbcacq.design.adaptive.next_plan import (
    MOST_NAMED,
    NextPoses,
    choose_next,
    costs_of,
    moved_artefacts,
    pair_in_words,
    set_in_words,
    steps_of,
)
from mbcacq.design.adaptive.options import OPTIONS
from mbcacq.design.adaptive.pool import reachable_views
from mbcacq.design.adaptive.questions import doubtful
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.interim import InterimEvidence, weigh
from mbcacq.effects import catalogue
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.errors import ConfigError
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, load
from mbcacq.plan.growth import with_steps
from mbcacq.plan.schema import Taught

LARGEST = 1e6  # usual sizes: JSON has no infinity, and what the geometry absorbs has no limit
# Every figure of a decision is the same to the last bit wherever it is made. Two threads of linear algebra add up in another order than
# one. A command has one thread; a program that imports the library has as many as the computer has cores.
repeatable = threadpool_limits.wrap(1)
Steps = list[dict[str, Any]]
Measure = Callable[[LoadedPlan], Observations]  # a plan, of which the first poses may be measured already -> all that is measured


@dataclass(frozen=True)
class Budget:
    """Limits of an investigation.

    Attributes
    ----------
    poses
        Largest number of poses.
    moves, minutes
        Largest number of moves of artefacts, and longest duration; None for any.
    limit_mm
        Error of length that matters, mm (of 95 % of lengths in the workspace). An effect that causes less need not be found. None: effects
        of usual size are to be found.
    """

    poses: int = 96
    moves: int | None = None
    minutes: float | None = None
    limit_mm: float | None = None


@dataclass(frozen=True)
class Decision:
    """One look and what follows from it.

    Attributes
    ----------
    number : int
        0, 1 ..
    poses, moves, seconds
        Measured and needed until then.
    verdict, log_e_value
        Verdict and logarithm of the e-value.
    sets : tuple[tuple[str, float], ...]
        Those that are not excluded, in words, with their odds against the first.
    excluded : float
        Share of the effects of the catalogue that are excluded at the size that matters.
    further : float
        Odds of a further effect beside the most probable set.
    hiding : tuple[tuple[str, float], ...]
        The effects that could hide, each as large as it is not excluded, in usual sizes.
    reasons : tuple[str, ...]
        Questions to the next visit.
    steps : Steps
        That visit as steps of a plan; none at the end.
    end : str
        Why the investigation ended, '' while it goes on.
    """

    number: int
    poses: int
    moves: int
    seconds: float
    verdict: str
    log_e_value: float
    sets: tuple[tuple[str, float], ...]
    excluded: float
    reasons: tuple[str, ...]
    steps: Steps = field(default_factory=list)
    end: str = ""
    further: float = 0.0
    hiding: tuple[tuple[str, float], ...] = ()

    @property
    def sentence(self) -> str:
        """The result and the next step, in one line."""
        named = "; ".join(f"{name} ({odds:.2g})" if k else name for k, (name, odds) in enumerate(self.sets[:4]))
        going_on = ", ".join(f"{len(s['poses_deg'])} poses at station {s['station']}" for s in self.steps)
        then = f"next: {going_on}" if self.steps else self.end
        return f"{self.poses} poses, {self.moves} moves: {self.verdict} [{named}]; {then}"


def decisions(
    loaded: LoadedPlan,
    measure: Measure,
    budget: Budget | None = None,
    before: Sequence[Decision] = (),
    measured: Observations | None = None,
    seed: int = 0,
) -> Iterator[Decision]:
    """Decisions one after the other; after each of them its visit is measured, and the last one says why there is none.

    loaded: the plan of the cell. measure: called with the plan that has grown so far; returns everything that is measured. before:
    decisions that were made already, which are replayed. measured: a recording with which to begin, instead of a first block. seed: of
    random views.

    Raises what ``measure`` raises, and CalibrationError if the data do not determine the geometry.
    """
    budget = budget or Budget()
    grown = loaded if measured is not None else repeatable(first_block)(loaded)
    for decision in before:
        yield decision
        if decision.end:
            return
        grown = _with_visit(grown, decision)
    obs = measured if measured is not None and not before else measure(grown)
    number, views = len(before), list[PlannedPose]()
    while True:
        views = views or repeatable(reachable_views)(loaded, seed)
        with likely_cause_named(obs):
            found = weigh(_used(obs))
        decision = _decided(number, grown, found, budget, views)
        yield decision
        if decision.end:
            return
        grown = _with_visit(grown, decision)
        obs, number = measure(grown), number + 1


def _with_visit(grown: LoadedPlan, decision: Decision) -> LoadedPlan:
    """The plan with the visit of a decision after all others."""
    return replace(load(grown.path, with_steps(grown, decision.steps)), grown_from=grown.grown_from)


def _used(obs: Observations) -> Observations:
    """Without the poses that judge the calibration."""
    return obs if obs.phase is None else obs.select(obs.phase != "verification")


@repeatable
def _decided(number: int, grown: LoadedPlan, look: InterimEvidence, budget: Budget, views: Sequence[PlannedPose]) -> Decision:
    obs = look.problem.linear.obs
    moves, seconds = effort(grown, obs)
    hiding = look.hiding(budget.limit_mm)
    sizes, log_e = {e.label: e.in_typical_sizes for e in look.limited}, look.full.evidence.log_e_value
    hidden = tuple((label, min(sizes[label], LARGEST)) for label in sorted(hiding, key=lambda one: -hiding[one]))
    about = Decision(number, obs.n_poses, moves, seconds, look.verdict, log_e, _sets(look), excluded=1.0 - sum(hiding.values()), reasons=())
    made = replace(about, further=look.further_odds, hiding=hidden)
    known = sure(look)
    if known and made.excluded >= OPTIONS.excluded:
        return replace(made, end=_known(look, made))
    left, moves_left = budget.poses - obs.n_poses, None if budget.moves is None else budget.moves - moves
    if left < OPTIONS.fewest or (budget.minutes is not None and seconds > 60 * budget.minutes):
        return replace(made, end=f"the budget is spent; {_open(look, made)}")
    chosen = choose_next(look, grown, visits=1, poses=left, moves=moves_left, views=views)
    beyond = sum(
        share
        for label, share in hiding.items()
        if label not in chosen.shown and not catalogue.declaration(label.partition(":")[0]).acts_in_time
    )  # time shows by waiting
    if known and made.excluded + beyond >= OPTIONS.excluded:
        return replace(made, end=f"{_known(look, made)}, and no view that can be taken shows most of them")
    if not chosen.visits:
        return replace(made, reasons=tuple(chosen.reasons), end=_futile(chosen, look, made))
    return replace(
        made,
        reasons=tuple(chosen.reasons),
        steps=steps_of(grown, chosen.visits, 1 + sum(isinstance(step, Taught) for step in grown.plan.steps)),
    )


def sure(look: InterimEvidence) -> bool:
    """Whether the statement of a diagnosis would be reliable. "No effect" is reliable after a first block, if no effect is half as probable
    as none. Effects are reliable if each shows by enough information, and no further one is probable beside them.
    """
    if look.verdict == "cannot_tell":
        return False
    fit = look.full.evidence
    if look.verdict == "none" or not fit.significant:
        return look.verdict == "none" and not doubtful(look) and look.problem.linear.obs.n_poses >= OPTIONS.first_block
    if look.further_odds > OPTIONS.further:
        return False
    return all(lost >= OPTIONS.sure for lost in _lost_without(look.reported, fit.hypotheses))


def _lost_without(reported: Hypothesis, compared: Sequence[Hypothesis]) -> list[float]:
    """Log evidence that a set loses without each of its effects, as far as that was compared; a single effect is compared with none."""
    out = []
    for label in reported.labels:
        rest = [h for h in compared if h.labels == reported.labels - {label}]
        if rest:
            out.append(reported.log_evidence - max(h.log_evidence for h in rest))
    return out


def _sets(look: InterimEvidence) -> tuple[tuple[str, float], ...]:
    fit = look.full.evidence
    found = [look.reported, *look.alternatives] if fit.significant else [fit.none, *(h for h in fit.hypotheses if h.members)][:4]
    first = found[0].log_posterior
    words = [(set_in_words(sorted(h.labels)), float(np.exp(min(h.log_posterior - first, 50.0)))) for h in found]
    return tuple(dict(reversed(words)).items())[::-1] if len(dict(words)) < len(words) else tuple(words)


def _known(look: InterimEvidence, made: Decision) -> str:
    if look.verdict == "none":
        return f"no effect: {made.excluded:.0%} of the effects of the catalogue are excluded{_named(made, ', not')}"
    found, left = set_in_words(sorted(look.reported.labels)), 1 - made.excluded
    return f"known: {found}; {left:.0%} of the other effects of the catalogue could still hide{_named(made)}"


def _open(look: InterimEvidence, made: Decision) -> str:
    others = [set_in_words(sorted(h.labels)) for h in look.alternatives]
    if not look.full.evidence.significant:
        return f"no effect is shown, {made.excluded:.0%} of the effects of the catalogue are excluded{_named(made)}"
    if look.verdict == "explained":
        odds = odds_in_words(made.further)
        return f"{_known(look, made)}; that there is a further effect has {odds}"
    return f"left open: {' or '.join(dict.fromkeys([set_in_words(sorted(look.reported.labels)), *others]))}"


def _named(made: Decision, such_as: str = ", such as") -> str:
    """The effects that stand for the largest shares of what could hide."""
    named = ", ".join(effect_in_words(label) for label, _ in made.hiding[:MOST_NAMED])
    return f"{such_as} {named}" if named else ""


def _futile(chosen: NextPoses, look: InterimEvidence, made: Decision) -> str:
    if chosen.futile and chosen.open_pairs:
        return "; ".join(pair_in_words(pair) for pair in chosen.open_pairs)
    return f"nothing that can be reached would decide more; {_open(look, made)}"


def effort(loaded: LoadedPlan, obs: Observations) -> tuple[int, float]:
    """Moves of artefacts, and seconds that a recording took or was planned to take."""
    costs, moves = costs_of(loaded, None), moved_artefacts(obs)[0]
    return moves, moves * costs.move_s + obs.n_poses * costs.pose_s


def refuse_empty(budget: Budget) -> None:
    """Raises ConfigError if a budget allows nothing."""
    if budget.poses < OPTIONS.first_block:
        raise ConfigError(f"{budget.poses} poses are fewer than the first block of {OPTIONS.first_block}; allow more")
