"""What to measure next: measured postures at which alternatives differ most, or at which what could not have been seen would show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.findings import Advice
from mbcacq.diagnosis.search.effect_columns import candidate_columns
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation import forward_model
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees

TRIED, GIVEN = 400, 6  # postures that are tried, and poses that one piece of advice gives


def in_words(effects: Sequence[Member]) -> str:
    """Names and locations; those of one name together."""
    where: dict[str, list[str]] = {}
    for e in effects:
        where.setdefault(e.candidate.name, []).extend(e.candidate.where)
    return " with ".join(f"{name} at {'+'.join(sorted(set(at)))}" for name, at in where.items())


@dataclass(frozen=True)
class Elsewhere:
    """The cell at postures that the recording does not have, with all candidates as they would act there."""

    context: Context
    linear: LinearProblem

    @cached_property
    def candidates(self) -> dict[str, Candidate]:
        return {candidate.key: candidate for candidate in catalogue.candidates(self.context)[0]}

    def displacement(self, effect: Member) -> np.ndarray | None:
        """(P, 3) mm: what an effect of the recording would do at these postures; None if it cannot be built there."""
        key = effect.candidate.key
        if key not in self.candidates:
            return None
        columns = self.linear.computed_once((key, effect.hyper), lambda: candidate_columns(self.linear, self.candidates[key], effect.hyper))
        return columns[:, :3] @ effect.coefficients

    def displacement_together(self, effects: Sequence[Member]) -> np.ndarray | None:
        """The same of several effects together; None if one of them cannot be built."""
        each = [moved for e in effects if (moved := self.displacement(e)) is not None]
        return np.sum(each, axis=0) if len(each) == len(effects) else None


def elsewhere(context: Context) -> Elsewhere:
    """The same cell at random postures within limits and not below the lowest flange so far, one ball in the middle of the field each."""
    obs, robot = context.obs, context.obs.cell.robot
    rng = np.random.default_rng(0)
    low = np.maximum(robot.limits[:, 0], -np.pi)
    high = np.minimum(robot.limits[:, 1], np.pi)
    q = rng.uniform(low, high, (8 * TRIED, robot.n))
    height = robot.chain.frames(obs.q)[:, -1, 2, 3].min()
    q = q[robot.chain.frames(q)[:, -1, 2, 3] > height][:TRIED]
    direction = None if obs.direction is None else rng.choice([-1.0, 1.0], q.shape)
    return _at(context, q, np.full(len(q), obs.station[0]), direction, np.zeros(len(q), int))


def as_measured(context: Context) -> Elsewhere:
    """The cell at the postures of the recording, which can be taken once more, one ball in the middle of the field each."""
    obs = context.obs
    return _at(context, obs.q, obs.station, obs.direction, obs.recording)


def _at(context: Context, q: np.ndarray, station: np.ndarray, direction: np.ndarray | None, recording: np.ndarray | None) -> Elsewhere:
    obs, count = context.obs, len(q)
    each, ball = np.arange(count), np.full(count, obs.ball[0])
    blank = Observations(obs.cell, each, station, q, each, ball, np.zeros((count, 3)), direction=direction)
    blank = replace(blank, recording=None if obs.recording is None else recording)
    if obs.rotation is not None:
        blank = replace(blank, rotation=np.tile(np.eye(3), (count, 1, 1)))
    there = Context(blank, context.state, forward_model.predict(blank, context.state))
    return Elsewhere(there, LinearProblem.of(blank, context.state))


def separating(context: Context, pairs: Sequence[tuple[Sequence[Member], Sequence[Member]]]) -> list[Advice]:
    """One piece of advice for each pair of descriptions that the recording cannot tell apart, where there is one: measured postures, for
    nothing is known of the cell that says which others can be taken. With its plan, ``mbcacq diagnose --next`` chooses among all views.
    """
    out, there = [], as_measured(context)
    for pair in pairs:
        names = [" with ".join(dict.fromkeys(e.candidate.name for e in one)) for one in pair]
        if any(catalogue.declaration(e.candidate.name).acts_in_time for one in pair for e in one):
            reason = f"{' and '.join(names)} differ in time: measure the first station again, at the same postures, at the end"
            out.append(Advice(reason, first_poses(context)))
            continue
        a, b = (there.displacement_together(one) for one in pair)
        if a is not None and b is not None:
            apart = a - b
            chosen = spread(apart)
            most = float(np.linalg.norm(apart[chosen], axis=1).mean())
            ours, theirs = map(in_words, pair)
            both = f"{ours} and {theirs}" if ours != theirs else f"{ours} alone and beside an unmodelled effect"
            reason = f"{both} differ by {most:.3f} mm at the poses that separate them best: measure those again, and others like them"
            out.append(Advice(reason, _in_degrees(there.context.obs.q[chosen])))
    return out


def revealing(context: Context, limited: Sequence[Member]) -> list[Advice]:
    """Measured postures that show one effect. It is the effect that does most at its typical size, among those that are not excluded at
    that size. limited: each as large as the recording does not exclude it.
    """
    there = as_measured(context)
    typical = [replace(e, coefficients=e.candidate.typical) for e in limited if e.in_typical_sizes > 1.0]
    each = [(e, moved) for e in typical if (moved := there.displacement(e)) is not None]
    if not each:
        return []
    hidden, moved = max(each, key=lambda item: np.linalg.norm(item[1], axis=1).max())
    name = in_words((hidden,))
    reason = f"{name} of usual size would not have shown: measure these poses again, and others like them, or a long bar end by end"
    return [Advice(reason, _in_degrees(there.context.obs.q[spread(moved)]))]


def spread(moved: np.ndarray) -> np.ndarray:
    """Indices of poses whose displacements (P, 3) are large and point to different sides: greedy, farthest from those chosen."""
    chosen = [int(np.argmax(np.linalg.norm(moved - moved.mean(axis=0), axis=1)))]
    while len(chosen) < min(GIVEN, len(moved)):
        nearest = np.min(np.linalg.norm(moved[:, None] - moved[None, chosen], axis=2), axis=1)
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


def first_poses(context: Context) -> tuple[tuple[float, ...], ...]:
    """Joint angles (deg) at the station that was measured first."""
    first = context.obs.station[np.argmin(context.order)]
    return _in_degrees(context.obs.q[context.obs.station == first][:GIVEN])


def _in_degrees(q: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in in_degrees(q).round(3))


ROUNDED = 1e-10  # share of an effect's displacement below which what is left of it is rounding


def harmless(there: Elsewhere, effect: Member) -> bool:
    """Whether an effect displaces everything alike, as a constant sag does: no length shows it, nor suffers from it."""
    workspace, length = errors_elsewhere(there, replace(effect, coefficients=effect.candidate.typical))
    return workspace is not None and length is not None and length < ROUNDED * workspace


def errors_elsewhere(there: Elsewhere, effect: Member) -> tuple[float | None, float | None]:
    """Largest displacement (mm) over postures in the workspace, and the error of lengths between pairs of them that 95 % do not exceed.

    None for what the geometry absorbs, for effects over time, which no posture has, and for single balls or stations.
    """
    return errors_of(there, there.displacement(effect) if np.isfinite(effect.in_typical_sizes) else None)


def errors_of(there: Elsewhere, moved: np.ndarray | None) -> tuple[float | None, float | None]:
    """The same of displacements (P, 3) mm at these postures."""
    if moved is None or not np.any(moved):
        return None, None
    linear = there.linear
    T = linear.prediction.T_base_scanner if there.context.scanner_on_flange else linear.prediction.T_base_station
    in_base = np.einsum("pij,pj->pi", T[:, :3, :3], moved)
    position = linear.prediction.T_base_scanner[:, :3, 3]
    first, second = np.random.default_rng(0).integers(0, len(position), (2, len(position)))
    apart = position[first] - position[second]
    along = apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
    length = np.abs(np.sum((in_base[first] - in_base[second]) * along, axis=1))
    return float(np.linalg.norm(moved, axis=1).max()), float(np.quantile(length, 0.95))
