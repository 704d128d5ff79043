"""Whether a recording is described as it was made: simple changes of its description, compared by a quick fit of the plain geometry.

The solver of every calibration fits hand-eye and stations to the arm as described, without its noise. All centres count alike, then the
closest ones, so that single wrong rows do not decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.description_hypotheses import Misreading, exchanged_balls, hypotheses, other_arms
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.estimation.adjustment import as_it_is
from mbcacq.estimation.initial_guess import start
from mbcacq.estimation.solution import Solution
from mbcacq.estimation.solver import solve
from mbcacq.model.observations import Observations

LEVER_MM = 100.0  # of the point that stands for an orientation
MOST_POSES = 60  # a convention shows in few
MOST_STATIONS = 6
STEPS, SCREENING_STEPS = 12, 3  # of the solver; conventions differ by more than its last digit
SETTLED = 1e-4  # mm^2 of the sum of squares
KEPT = 0.8  # share of the smallest squared distances that the residual counts
MOST, OF_ANOTHER_ARM = 0.3, 0.2  # share of the misfit that may remain with a change, and with the links of another arm
SAME = 1.25  # factor within which two changes explain as much and cannot be told apart
LIKELIER = ("sign", "unit", "handedness", "orientation", "order", "offset", "coupling", "frame", "rows", "arm")  # of those that fit alike
SCREENED = 8  # changes of the smallest residual in a few steps that are fitted to the end
MOST_ALTERNATIVES = 3  # named in the text; a mirror of positions is any mirror
MOST_CHANGES = 2  # mistakes found one after the other


@dataclass(frozen=True)
class DescriptionFinding:
    """A mistake of the description that fits. before_mm, after_mm: residual without and with its change; alternatives: those that fit as
    well, in words."""

    mistake: Misreading
    before_mm: float
    after_mm: float
    alternatives: tuple[str, ...]

    @property
    def what(self) -> str:
        """The change in words, after 'with'."""
        return self.mistake.what

    def __str__(self) -> str:
        text = f"with {self.what} the residual falls from {_number(self.before_mm)} to {_number(self.after_mm)} mm"
        if not self.alternatives:
            return text
        more = len(self.alternatives) - MOST_ALTERNATIVES
        others = " or ".join(self.alternatives[:MOST_ALTERNATIVES])
        return f"{text} (the data cannot tell it from {others}{f' and {more} more' if more > 0 else ''})"


def misdescribed(obs: Observations) -> str:
    """A sentence on what is described otherwise than it was measured: numbers of balls, signs, units, orders and frames, the arm; '' where
    no simple change of the description removes most of the misfit."""
    if exchanged := exchanged_balls(obs):
        return exchanged
    if found := wrong_descriptions(obs):
        return "; ".join(map(str, found))
    arm = _best(obs, other_arms(obs), OF_ANOTHER_ARM)
    return f"{arm}; name that arm" if arm else ""


@contextmanager
def likely_cause_named(observations: Observations) -> Iterator[None]:
    """An error that the recording contradicts its cell also names the simple change of the description that removes most of the misfit, if
    there is one.
    """
    try:
        yield
    except ContradictionError as error:
        found = misdescribed(observations)
        raise (CalibrationError(f"{error}; {found}") if found else error) from None


def wrong_descriptions(observations: Observations) -> tuple[DescriptionFinding, ...]:
    """Changes of convention that remove most of the misfit, in the order of finding: each was sought with those before it made."""
    found: list[DescriptionFinding] = []
    current = observations
    for _ in range(MOST_CHANGES):
        finding = _best(current, hypotheses(current), MOST)
        if finding is None:
            break
        found.append(finding)
        current = finding.mistake.change(current)
    return tuple(found)


def _best(observations: Observations, among: Iterable[Misreading], most: float) -> DescriptionFinding | None:
    """The change that fits best, where it leaves at most a share ``most`` of the misfit; all are screened, the best are fitted."""
    few = subset(observations)
    before = residual_mm(few)
    screened = sorted(((_score(observations, few, h, True), i, h) for i, h in enumerate(among)), key=lambda s: s[:2])
    scored = sorted(((_score(observations, few, h, False), i, h) for _, i, h in screened[:SCREENED]), key=lambda s: s[:2])
    near = [(score, h) for score, _, h in scored if score < min(most * before, SAME * scored[0][0])]
    if not near:
        return None
    near.sort(key=lambda pair: LIKELIER.index(pair[1].kind))
    score, best = near[0]
    others = sorted((h for _, h in near[1:]), key=lambda h: h.kind == best.kind)  # mistakes of another kind are named first
    return DescriptionFinding(best, before, score, tuple(h.what for h in others))


def _score(observations: Observations, few: Observations, hypothesis: Misreading, screening: bool) -> float:
    """Infinite where the change leaves nothing that can be fitted. few: the subset that is fitted; rows are moved before it is taken."""
    try:
        changed = subset(hypothesis.change(observations)) if hypothesis.kind == "rows" else hypothesis.change(few)
        return residual_mm(changed, screening)
    except (ValueError, np.linalg.LinAlgError):
        return float("inf")


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 1e4 else f"{value:.0f}"


def subset(observations: Observations) -> Observations:
    """At most ``MOST_POSES`` poses of the stations that have most of them, evenly chosen."""
    stations, counts = np.unique(observations.station, return_counts=True)
    largest = stations[np.argsort(-counts, kind="stable")[:MOST_STATIONS]]
    measured = np.zeros(observations.n_poses, dtype=bool)
    measured[observations.pose] = True
    usable = np.flatnonzero(np.isin(observations.station, largest) & measured)
    keep = np.zeros(observations.n_poses, dtype=bool)
    keep[usable[np.unique(np.linspace(0, len(usable) - 1, MOST_POSES).astype(int))]] = True
    return observations.select(keep)


def residual_mm(o: Observations, screening: bool = False) -> float:
    """Root mean square distance (mm) of the ``KEPT`` closest centres after the fit; infinite where it fails. A measured orientation counts
    as a point ``LEVER_MM`` away. screening: from the start alone and in few steps, enough where the description is right."""
    at = solve(as_it_is(o, start(o), hold=False), tolerance=SETTLED, limit=SCREENING_STEPS if screening else STEPS)
    if not screening:
        square = _squares(at)
        closest = (square <= np.quantile(square, KEPT)).astype(float)
        at = solve(at, weights=replace(at.weights, centre=closest), tolerance=SETTLED, limit=STEPS)
    square = np.sort(_squares(at))
    found = float(np.sqrt(square[: max(int(KEPT * len(square)), 1)].mean()))
    return found if np.isfinite(found) else float("inf")


def _squares(at: Solution) -> np.ndarray:
    """(M,) mm^2 of each centre."""
    return np.sum(at.residual[:, :3] ** 2, axis=1) + np.sum((LEVER_MM * at.residual[:, 3:]) ** 2, axis=1)
