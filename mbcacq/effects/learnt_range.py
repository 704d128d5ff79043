"""Where a covariate was in the recording that an effect was learnt from, and what holds beyond it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat

from mbcacq.effects.covariates import OF_RECORDING, Covariates
from mbcacq.effects.functions import REPEATING, DescribedPart
from mbcacq.quantities import DEGREE

MOVEMENT = "movement_"
TRAVEL = "travel_"  # covariates of a joint's last motion
LOADS = ("gravity_torque_", "gravity_moment_", "payload_force_", "payload_torque_")
STANDSTILL = ("qd", "direction_", MOVEMENT)  # covariates that are zero where nothing is recorded of them
GAP = 5.0 * DEGREE  # between visited angles from which the angles between count as not visited
MARGIN = 0.02  # of a range, by which a value may leave it
FADES_OVER = 70.0 * DEGREE  # beyond the visited angles: what errors of bearings and gears have in common over so wide an angle (third.md)
FADES_OVER_SHARE = 0.1  # the same, of the range of any other covariate


@dataclass(frozen=True)
class LearntRange:
    """Values of a covariate in the recording learnt from: intervals that were visited, and the mean. Ranges of an angle are modulo a turn,
    unless turns count (``counts_turns``), because a function of it does not repeat.
    """

    intervals: Annotated[tuple[tuple[FiniteFloat, FiniteFloat], ...], Field(min_length=1)]
    mean: FiniteFloat
    counts_turns: bool = False

    @classmethod
    def of(cls, name: str, values: np.ndarray, counts_turns: bool) -> LearntRange:
        """The range of values (k,)."""
        mean = float(np.mean(values))
        if not is_angle(name):
            return cls(((float(np.min(values)), float(np.max(values))),), mean)
        visited = np.sort(values if counts_turns else np.mod(values, 2 * np.pi))
        ends = np.flatnonzero(np.diff(visited) > GAP)
        begin, end = visited[np.concatenate([[0], ends + 1])], visited[np.concatenate([ends, [-1]])]
        return cls(tuple((float(a), float(b)) for a, b in zip(begin, end, strict=True)), mean, counts_turns)

    @property
    def low(self) -> float:
        return self.intervals[0][0]

    @property
    def high(self) -> float:
        return self.intervals[-1][1]

    def outside(self, name: str, values: np.ndarray) -> np.ndarray:
        """(k,) bool: values that lie in none of the intervals."""
        return self.beyond(name, values) > 0.0

    def beyond(self, name: str, values: np.ndarray) -> np.ndarray:
        """(k,) distance of values from the nearest interval, less the margin that is taken to belong to it."""
        angle = is_angle(name)
        repeats = angle and not self.counts_turns
        x = np.mod(values, 2 * np.pi) if repeats else np.asarray(values, dtype=float)
        distance = np.full(np.shape(x), np.inf)
        for low, high in self.intervals:
            for turn in (-2 * np.pi, 0.0, 2 * np.pi) if repeats else (0.0,):
                distance = np.minimum(distance, np.maximum(np.maximum(low + turn - x, x - high - turn), 0.0))
        return np.maximum(distance - self.margin(name), 0.0)

    def margin(self, name: str) -> float:
        """By how much a value may leave the range and still belongs to it."""
        return float(GAP) if is_angle(name) else MARGIN * (self.high - self.low) + 1e-12

    def held(self, name: str, values: np.ndarray) -> np.ndarray:
        """Values (k,) that leave the range at its nearest end. Between visited values a function goes on: only what lies before the first
        and behind the last is held; of an angle that repeats, what lies in the largest gap.
        """
        if not is_angle(name) or self.counts_turns:
            return np.clip(values, self.low, self.high)
        start, width = self._arc
        if 2 * np.pi - width < 2 * GAP:
            return values
        on = np.mod(values - start, 2 * np.pi)
        before = np.minimum(2 * np.pi - on, on - width)  # to the nearer end
        return np.where(on <= width, values, np.where(on - width == before, values - before, values + before))

    @property
    def _arc(self) -> tuple[float, float]:
        """Start and width (rad) of the arc that holds all visited angles."""
        ends = np.array(self.intervals)
        gaps = np.append(ends[1:, 0], ends[0, 0] + 2 * np.pi) - ends[:, 1]
        last = int(gaps.argmax())
        return float(ends[(last + 1) % len(ends), 0]), float(2 * np.pi - gaps[last])

    def within(self, name: str, values: np.ndarray) -> np.ndarray:
        """(k,) 1 in the range, falling to nought outside of it."""
        width = FADES_OVER if is_angle(name) else FADES_OVER_SHARE * (self.high - self.low) + 1e-12
        return np.exp(-0.5 * (self.beyond(name, values) / width) ** 2)


def learnt_ranges(here: Covariates, parts: Iterable[DescribedPart]) -> dict[str, LearntRange]:
    """The range of every covariate of some parts in a recording; without those that have a meaning there alone."""
    functions = [f for part in parts for column in part.columns for product in column for f in product.functions]
    counting_turns = {f.covariate for f in functions if f.kind not in REPEATING}
    names = {f.covariate for f in functions if not f.covariate.startswith((MOVEMENT, TRAVEL))} - {*OF_RECORDING, "ball"}
    return {name: learnt_range(here, name, name in counting_turns) for name in sorted(names)}


def learnt_range(here: Covariates, name: str, counts_turns: bool) -> LearntRange:
    """The range of a covariate in a recording."""
    key = "learnt range", name, "turns" if counts_turns else ""
    return here.computed_once(key, lambda: LearntRange.of(name, here.value(name), counts_turns))


def loads(names: Iterable[str]) -> tuple[str, ...]:
    """The covariates that are forces or torques."""
    return tuple(sorted(n for n in names if n.startswith(LOADS)))


def with_a_range(names: Iterable[str]) -> tuple[str, ...]:
    """The covariates beyond whose learnt range nothing is known. What a motion leaves behind is zero at rest, wherever it is."""
    return tuple(sorted(n for n in names if n not in (*OF_RECORDING, "ball") and not n.startswith((*STANDSTILL, TRAVEL))))


def own_angle(axis: str) -> str:
    """The covariate that is the angle of a joint, by the joint's name."""
    return f"q{axis.removeprefix('A')}"


def is_angle(name: str) -> bool:
    """Whether a covariate is the angle of a joint, so that a full turn leads to the same place."""
    return name[:1] == "q" and name[1:].removeprefix("E").isdigit()
