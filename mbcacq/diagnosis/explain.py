"""Competition of named effects: a beam search over sets of effects, each set refitted together with the whole geometry.

Every member pays for its coefficients and for the number of places and hyper-parameters it was picked from; a set may not
contain what physics forbids (a negative compliance). So a string of wrong names must beat the right one to be told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

from mbcacq.diagnosis.screen import Scored, Screen, prior_weight
from mbcacq.physics import payload
from mbcacq.physics.effect import Candidate
from mbcacq.physics.situation import Situation

FALSE_ALARM = 0.01
SIGNIFICANT = 0.001  # own p-value beyond which a member is not told, whatever it was found with
NEW_FAMILY = 4.0
LONGEST = 20
FEW = 4  # members up to which exchanging them is tried several times even in a long recording
APART = 0.02  # share of a member's information that must be left beside the other members
FAMILIES = 20
COMPANIONS = ("joint_compliance", "gear_transmission_error", "backlash", "thermal_growth", "joint_scale")  # where one is, others are likely


@dataclass(frozen=True)
class Model:
    """A set of effects. gain: of all together over free geometry alone; score: gain less what the members cost."""

    members: tuple[tuple[Candidate, float | None], ...]
    gain: float
    score: float
    coefficients: np.ndarray
    covariance: np.ndarray

    def parts(self) -> list[slice]:
        ends = np.cumsum([0] + [c.k for c, _ in self.members])
        return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted({c.name for c, _ in self.members}))


NOTHING = Model((), 0.0, 0.0, np.zeros(0), np.zeros((0, 0)))


@dataclass(frozen=True)
class Search:
    """The candidates of these data and how they are weighed."""

    candidates: list[Candidate]
    beam: int = 3
    branches: int = 6
    most: int = 12
    thorough: bool = True
    least_share: float = 0.0
    protected: frozenset[str] = frozenset()
    situation: Situation | None = None

    def run(self, screen: Screen, start: Model = NOTHING) -> Model:
        """The best set of effects under the screen's noise."""
        beam, best = [start], start
        for _ in range(self.most):
            grown: dict[tuple, Model] = {}
            for model in beam:
                branches = self.expand(screen, model)
                for more in [(b,) for b in branches[: self.branches]] + ([] if self.thorough else [at_different_places(branches)]):
                    new = self.solve(screen, (*model.members, *((s.candidate, s.hyper) for s in more)))
                    if new is not None and new.score > model.score:
                        key = tuple(sorted((c.key, round(h or 0.0, 2)) for c, h in new.members))
                        grown.setdefault(key, new)
            if not grown:
                break
            beam = sorted(grown.values(), key=lambda m: -m.score)[: self.beam]
            if beam[0].score > best.score:
                best = beam[0]
            elif beam[0].score < best.score - 20:
                break
            if len(best.members) >= LONGEST:
                break  # the smooth model is the better place for what is left
        return self.consistent(screen, self.polish(screen, best))

    def polish(self, screen: Screen, model: Model) -> Model:
        """Drop members that do not pay, exchange members for better ones, until nothing improves."""
        for _ in range(6 if self.thorough else 3 if len(model.members) <= FEW else 1):
            improved = model
            for j in range(len(model.members)):
                protected = self.is_protected(model, j)
                rest = self.solve(screen, model.members[:j] + model.members[j + 1:])
                if rest is None:
                    continue
                if rest.score > improved.score and not protected:
                    improved = rest
                candidate, hyper = model.members[j]
                if len(model.members) > 6 and (candidate.several and hyper > 4.0):
                    continue  # a fast wiggle can be nothing else
                possible = [s for s in self.expand(screen, rest) if not (protected and s.candidate.several)]
                for scored in possible[:2]:
                    other = self.solve(screen, (*rest.members, (scored.candidate, scored.hyper)))
                    if other is not None and other.score > improved.score + 1e-6:
                        improved = other
            if improved is model:
                return model
            model = improved
        return model

    def pruned(self, screen: Screen, model: Model) -> Model:
        """Without the members that no longer pay, one by one, under the noise and beside whatever was found in the end.

        screen: may have groups without a name projected out, which can make a name superfluous that was needed before them.
        """
        if payload.NAME in model.names:  # elasticity beside a wrong tool is kept on purpose
            return model
        model = self.solve(screen, model.members, permit=True)
        while model.members:
            rest = [self.solve(screen, model.members[:j] + model.members[j + 1:], permit=True) for j in range(len(model.members))]
            dead = [m for m, lost in zip(rest, self.lost(model, rest), strict=True) if lost > SIGNIFICANT]
            free = [m for j, m in enumerate(rest) if not self.is_protected(model, j)]
            best = max(dead or [m for m in free if m.score > model.score], key=lambda m: m.gain if dead else m.score, default=None)
            if best is None:
                break
            model = best
        return model

    @staticmethod
    def lost(model: Model, rest: list[Model]) -> list[float]:
        """p-value (n,) of each member beside the others: chi2 that is lost without it."""
        return [float(chi2.sf(max(model.gain - m.gain, 0.0), c.k)) for m, (c, _) in zip(rest, model.members, strict=True)]

    def is_protected(self, model: Model, j: int) -> bool:
        """Members that stay as long as they are significant: elasticity, which every arm has, gives way to no periodic error."""
        at = model.parts()[j].start
        return model.members[j][0].key in self.protected and model.coefficients[at] > 3 * np.sqrt(model.covariance[at, at])

    def expand(self, screen: Screen, model: Model) -> list[Scored]:
        """Candidates beyond a model at their best hyper-parameter, best first; those that cannot pay are left out."""
        here = screen.adopted([(screen.block(c, h), prior_weight(c)) for c, h in model.members])
        out = []
        for candidate in [*self.candidates, *self.beside(model)]:
            if not self.allowed(candidate, model):
                continue
            scored = best_hyper(here, candidate)
            if scored.gain > max(0.7 * self.cost(candidate, scored.hyper, model), self.least_share * screen.chi2):
                out.append(scored)
        return sorted(out, key=lambda s: self.cost(s.candidate, s.hyper, model) - s.gain)

    def beside(self, model: Model) -> list[Candidate]:
        """Candidates that exist only next to what the model has: a wrong payload next to elastic joints."""
        if self.situation is None:
            return []
        elastic = {int(c.where[0][1:]) - 1: model.coefficients[p.start] for (c, _), p in zip(model.members, model.parts(), strict=True)
                   if c.name == "joint_compliance"}
        return payload.beside(self.situation, {i: float(f"{c:.2g}") for i, c in elastic.items()})

    def consistent(self, screen: Screen, model: Model) -> Model:
        """A payload is found through elasticity as it was before the payload was known: both again, until they agree.

        Every loaded joint is elastic in this, significantly or not, so that the payload's uncertainty contains theirs.
        """
        if self.situation is None or payload.NAME not in model.names:
            return model
        softness = [c for c in self.candidates if c.name == "joint_compliance"]
        kept = tuple((c, h) for c, h in model.members if c.name != payload.NAME)
        soft = {c.where for c, _ in kept if c.name == "joint_compliance"}
        names = {(f"A{i + 1}",) for i in payload.loaded(self.situation)} - soft
        kept += tuple((c, None) for c in softness if c.where in names)
        elastic = {int(c.where[0][1:]) - 1: float(c.typical[0]) for c, _ in kept if c.name == "joint_compliance"}
        doubt, best = 0.0, model
        for _ in range(6):
            fresh = payload.beside(self.situation, elastic, doubt, complete=True)
            new = self.solve(screen, (*kept, (fresh[0], None)), permit=True) if fresh else None
            if new is None:
                return model
            found = {int(c.where[0][1:]) - 1: (new.coefficients[p.start], np.sqrt(new.covariance[p.start, p.start]))
                     for (c, _), p in zip(new.members, new.parts(), strict=True) if c.name == "joint_compliance"}
            if min(value for value, _ in found.values()) <= 0:
                return best
            elastic = {i: float(f"{value:.4g}") for i, (value, _) in found.items()}
            strongest = max(found, key=lambda i: found[i][0] / found[i][1])
            doubt, best = float(found[strongest][1] / found[strongest][0]), new
        return best

    def allowed(self, candidate: Candidate, model: Model) -> bool:
        same = [c for c, _ in model.members if c.name == candidate.name and c.where == candidate.where]
        return not same or candidate.several

    def cost(self, candidate: Candidate, hyper: float | None, model: Model) -> float:
        """chi2 that chance alone would give to the best of all candidates of this kind, once in 1 / FALSE_ALARM cells."""
        names = {c.name for c, _ in model.members}
        tries = sum(c.name == candidate.name for c in self.candidates)
        if candidate.hyper is not None:
            tries *= 2 * len(candidate.hyper.preferred) if hyper in candidate.hyper.preferred else 2 * candidate.hyper.independent
        out = threshold(candidate.k, round(np.log(max(tries, 1)), 1), candidate.name in names and candidate.name in COMPANIONS)
        if candidate.name in names and candidate.name not in COMPANIONS:
            out += NEW_FAMILY
        return out + (NEW_FAMILY if names and candidate.name not in names else 0.0)

    def collinear(self, model: Model, S: np.ndarray) -> bool:
        """Whether two names cancel each other: coefficients far less certain beside the others than they would be alone."""
        if len(model.names) < 2 or payload.NAME in model.names:
            return False
        for p in model.parts():
            own = S[p, p]
            other = np.linalg.inv(model.covariance[p, p])
            if np.linalg.eigvals(np.linalg.solve(own, other)).real.min() < APART:
                return True
        return False

    def solve(self, screen: Screen, members: tuple[tuple[Candidate, float | None], ...], permit: bool = False) -> Model | None:
        """All members and the geometry together; None where physics forbids the result and ``permit`` does not."""
        if not members:
            return NOTHING
        X = np.concatenate([screen.block(c, h) for c, h in members], axis=1)
        weight = np.concatenate([prior_weight(c) for c, _ in members])
        taken = screen.Q.T @ X
        if screen.more.shape[1]:
            raise ValueError("a set of effects is solved on a screen without adopted blocks")
        S = X.T @ X - taken.T @ taken + np.diag(weight)
        size = np.sqrt(np.diag(S))
        covariance = np.linalg.inv(S / np.outer(size, size) + 1e-12 * np.eye(len(S))) / np.outer(size, size)
        b = X.T @ screen.r
        coefficients = covariance @ b
        gain = float(b @ coefficients)
        cost, sofar = 0.0, NOTHING
        for candidate, hyper in members:
            cost += self.cost(candidate, hyper, sofar)
            sofar = replace(sofar, members=(*sofar.members, (candidate, hyper)))
        model = Model(members, gain, gain - cost, coefficients, covariance)
        if not permit and any(c.positive and coefficients[p.start] < 0 for (c, _), p in zip(members, model.parts(), strict=True)):
            return None
        if not permit and self.collinear(model, S):
            return None
        if not permit and payload.NAME in model.names and "joint_compliance" not in model.names:
            return None  # a rigid arm shows no payload
        return model


def at_different_places(branches: list[Scored]) -> tuple[Scored, ...]:
    """The best candidate of every place: many joints of a real arm err at once."""
    best: dict[tuple[str, ...], Scored] = {}
    for scored in branches:
        best.setdefault(scored.candidate.where, scored)
    return tuple(best.values())


@lru_cache(maxsize=10000)
def threshold(k: int, log_tries: float, family_present: bool) -> float:
    """A family that is there already makes its other members ten times as likely."""
    share = FALSE_ALARM / FAMILIES * (10.0 if family_present else 1.0)
    return float(chi2.isf(min(share / np.exp(log_tries), 0.2), k))


def best_hyper(screen: Screen, candidate: Candidate) -> Scored:
    """The candidate at the hyper-parameter that gains most; a preferred value is taken where it is as good."""
    hyper = candidate.hyper
    if hyper is None:
        return screen.test(candidate)
    if not candidate.separable:
        return max((screen.test(candidate, v) for v in hyper.values), key=lambda s: s.gain)
    curve = screen.scan(candidate)
    value, gain = hyper.values[np.argmax(curve)], curve.max()
    if hyper.refine:
        value, gain = refine(screen, candidate, value, gain)
    for preferred in hyper.preferred:
        if abs(preferred - value) < 1.5 * resolution(hyper) and screen.scan(candidate, np.array([preferred]))[0] > gain - 4.0:
            value = preferred
    return screen.test(candidate, float(value))


def resolution(hyper) -> float:
    ordered = np.sort(hyper.values)
    return float(np.median(np.diff(ordered)))


def refine(screen: Screen, candidate: Candidate, value: float, gain: float) -> tuple[float, float]:
    """Two rounds of a finer grid between the neighbours of the best value."""
    ordered = np.sort(candidate.hyper.values)
    j = int(np.searchsorted(ordered, value))
    low, high = ordered[max(j - 1, 0)], ordered[min(j + 1, len(ordered) - 1)]
    for _ in range(2):
        grid = np.linspace(low, high, 17)
        curve = screen.scan(candidate, grid)
        j = int(np.argmax(curve))
        if curve[j] > gain:
            value, gain = float(grid[j]), float(curve[j])
        low, high = grid[max(j - 1, 0)], grid[min(j + 1, 16)]
    return value, gain
