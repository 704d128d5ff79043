"""What a further effect costs: twice, because there are two questions.

Whether there is something at all is a test: an effect must gain what chance gives to the best of its kind only rarely (``threshold``).
Which of several it is, is a question of probability: what evidence takes off a gain, in which every coefficient pays for what it could
have fitted (``price``). A test's threshold alone would favour names of few coefficients.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

from mbcacq.diagnosis.search.effect_prior import EffectPrior
from mbcacq.diagnosis.search.effect_set import Members
from mbcacq.diagnosis.search.hyperparameters import values
from mbcacq.effects.effect import Candidate

FALSE_ALARM = 0.015  # over all places together, were the noise known; it is estimated, and about 2 % of clean recordings have one
FEWEST = 50.0  # shares into which it is cut at least: few candidates do not take all of it
FLATTER = 0.6  # power of the number of coefficients by which a share falls: more of them lose less by a rarer test
FAMILIES = 20
FURTHER = 4.0  # a further effect is less likely than the first, by a factor of seven
EXPECTED = 5.0  # times as likely as otherwise is an effect at another joint where one is
COMPANIONS = ("joint_compliance", "gear_transmission_error", "backlash", "thermal_growth", "joint_scale")  # of which that holds


class SelectionCriteria:
    """Of the candidates of one recording. ``present``: the candidates that are in the model already."""

    def __init__(self, candidates: Collection[Candidate]):
        self._places = Counter(c.name for c in candidates)
        self._sight: defaultdict[str, float] = defaultdict(float)
        for c in candidates:
            self._sight[c.name] += c.detectability
        self._level = FALSE_ALARM / max(sum(share(c) for c in candidates), FEWEST)

    def level(self, candidate: Candidate) -> float:
        """How often chance may let the best of a candidate's kind pass. Every place of every kind has its share, so that wherever and
        whatever an effect is, it is found at the same multiple of the strength that a test needs which knows it.
        """
        return self._level * share(candidate) * max(self._places[candidate.name], 1)

    def tries(self, candidate: Candidate, hyper: float | None, present: Collection[Candidate] = ()) -> float:
        """Number of independent chances that a candidate of this kind has: places (those that see little count, and get, little) times
        values of the hyper-parameter; where the same joint errs so already (a wheel and its mesh) the place is given. Half a chance
        where the sign is known: nothing yields backwards.
        """
        here = any(c.name == candidate.name and c.where == candidate.where for c in present)
        places = 1.0 if here else max(self._sight[candidate.name] / candidate.detectability, 1.0)
        if candidate.positive:
            places *= 0.5
        return places if candidate.hyper is None else places * values(candidate.hyper, hyper in candidate.hyper.preferred)

    def threshold(
        self, candidate: Candidate, hyper: float | None, present: Collection[Candidate], dof: float | None = None, rarer: float = 1.0
    ) -> float:
        """chi2 that chance alone gives to the best of all candidates of this kind in the share of cells that it may (``level``).

        dof: of the test's statistic, where not every coefficient is seen. rarer: times as many cells.
        """
        log_tries = round(np.log(rarer * self.tries(candidate, hyper, present)), 1)
        dof = round(dof, 1) if dof else float(candidate.k)
        level = self.level(candidate) * (EXPECTED if expected(candidate, present) else 1.0)
        return _threshold(dof, log_tries, level) + further(candidate, present)

    def cost(self, candidate: Candidate, hyper: float | None, present: Collection[Candidate], own: EffectPrior) -> float:
        """What the test takes off the gain: the threshold, and what was gained where hardly anything is seen.

        An effect may be strong just there (a pure turn of the scanner): a second test, ten times as rare by chance, counts all alike.
        """
        if candidate.k == 1:
            return self.threshold(candidate, hyper, present)
        statistic, dof = own.test
        alike = self.threshold(candidate, hyper, present, rarer=10.0)
        return min(self.threshold(candidate, hyper, present, dof) + own.gain - statistic, alike)

    def cost_together(self, members: Members, owns: Sequence[EffectPrior]) -> float:
        """The same of several effects of one kind, tested as one: each alone may be too weak."""
        kind, log_tries, dof, unseen = members[0][0], 0.0, 0.0, 0.0
        if len(members) < 2 or kind.name not in COMPANIONS or any(c.name != kind.name for c, _ in members):
            return np.inf
        for j, ((candidate, hyper), own) in enumerate(zip(members, owns, strict=True)):
            statistic, seen = own.test
            log_tries += np.log(self.tries(candidate, hyper, [c for c, _ in members[:j]]) / (j + 1))
            dof, unseen = dof + seen, unseen + own.gain - statistic
        return _threshold(round(dof, 1), round(log_tries, 1), self.level(kind)) + unseen

    def price(self, candidate: Candidate, hyper: float | None, present: Collection[Candidate], own: EffectPrior) -> float:
        """Twice the log of one over the candidate's share of what may be, and of what its coefficients could have fitted."""
        share = 2 * np.log(self.tries(candidate, hyper, present) * (1.0 if expected(candidate, present) else FAMILIES))
        return share + own.price + further(candidate, present)


def share(candidate: Candidate) -> float:
    """Of chance, to that of an effect of one coefficient."""
    return float(candidate.k**-FLATTER)


def expected(candidate: Candidate, present: Collection[Candidate]) -> bool:
    """Whether what is there makes this one likely: many joints of an arm are of one make."""
    return candidate.name in COMPANIONS and any(c.name == candidate.name for c in present)


def further(candidate: Candidate, present: Collection[Candidate]) -> float:
    return FURTHER if present and not expected(candidate, present) else 0.0


@lru_cache(maxsize=10000)
def _threshold(dof: float, log_tries: float, level: float) -> float:
    return float(chi2.isf(min(level / np.exp(log_tries), 0.2), dof))
