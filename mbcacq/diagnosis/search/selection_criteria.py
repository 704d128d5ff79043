"""The two criteria by which an effect is selected.

Detection is a test: an effect must gain what noise alone gives to the best of its kind only at a stated false-alarm rate (``threshold``).
Which of several effects it is, is a question of posterior probability, by the Occam penalty, in which every coefficient counts by what it
could have fitted (``occam_penalty``). A test's threshold alone would favour effects of few coefficients.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from mbcacq.diagnosis.search.effect_prior import EffectPrior
from mbcacq.diagnosis.search.effect_set import SelectedEffects
from mbcacq.diagnosis.search.hyperparameters import independent_values
from mbcacq.effects.effect import Candidate

FALSE_ALARM_RATE = 0.015  # of a clean recording, were the noise known; it is estimated, and about 2 % of them have one (challenge.md)
FEWEST_SHARES = 50.0  # into which that rate is cut at least: few candidates do not take all of it
SHARE_POWER = 0.6  # of the number of coefficients by which a share falls: more of them lose less by a rarer test
KINDS = 20  # of effects that are equally probable beforehand
FURTHER_EFFECT = 4.0  # a further effect is less likely than the first, by a factor of seven
COMPANION_FACTOR = 5.0  # times as likely as otherwise is an effect at another joint where one is
COMPANIONS = ("joint_compliance", "gear_transmission_error", "backlash", "thermal_growth", "joint_scale")  # of which that holds


class SelectionCriteria:
    """Of the candidates of one recording. ``present``: the candidates that are in the set already."""

    def __init__(self, candidates: Collection[Candidate]):
        self._locations = Counter(c.name for c in candidates)
        self._detectability: defaultdict[str, float] = defaultdict(float)
        for c in candidates:
            self._detectability[c.name] += c.detectability
        self._rate = FALSE_ALARM_RATE / max(sum(false_alarm_share(c) for c in candidates), FEWEST_SHARES)

    def false_alarm_rate(self, candidate: Candidate) -> float:
        """Share of the false-alarm rate given to a candidate's kind. Every location of every kind has its share, so that wherever and
        whatever an effect is, it is found at the same multiple of the strength that a test needs which knows it.
        """
        return self._rate * false_alarm_share(candidate) * max(self._locations[candidate.name], 1)

    def independent_trials(self, candidate: Candidate, hyper: float | None, present: Collection[Candidate] = ()) -> float:
        """Number of independent trials that a candidate of this kind has: locations (by their detectability) times values of the
        hyper-parameter; where the same joint errs so already (a wheel and its mesh) the location is given. Half a trial where the sign is
        known (a one-sided test): stiffness is positive.
        """
        here = any(c.name == candidate.name and c.where == candidate.where for c in present)
        locations = 1.0 if here else max(self._detectability[candidate.name] / candidate.detectability, 1.0)
        if candidate.positive:
            locations *= 0.5
        if candidate.hyper is None:
            return locations
        return locations * independent_values(candidate.hyper, hyper in candidate.hyper.preferred)

    def threshold(
        self, candidate: Candidate, hyper: float | None, present: Collection[Candidate], dof: float | None = None, rarer: float = 1.0
    ) -> float:
        """chi2 that noise alone gives to the best of all candidates of this kind at its share of the false-alarm rate.

        dof: of the test's statistic, where not every coefficient is determined. rarer: divides the rate.
        """
        log_trials = round(np.log(rarer * self.independent_trials(candidate, hyper, present)), 1)
        dof = round(dof, 1) if dof else float(candidate.k)
        rate = self.false_alarm_rate(candidate) * (COMPANION_FACTOR if is_companion(candidate, present) else 1.0)
        return _threshold(dof, log_trials, rate) + further_effect_penalty(candidate, present)

    def detection_threshold(self, candidate: Candidate, hyper: float | None, present: Collection[Candidate], own: EffectPrior) -> float:
        """What the test takes off the gain: the threshold, and what was gained where the coefficients are hardly determined.

        An effect may be strong just there (a pure rotation of the scanner): a second test, at a tenth of the rate, counts all directions
        alike.
        """
        if candidate.k == 1:
            return self.threshold(candidate, hyper, present)
        statistic, dof = own.detection_statistic
        alike = self.threshold(candidate, hyper, present, rarer=10.0)
        return min(self.threshold(candidate, hyper, present, dof) + own.gain - statistic, alike)

    def joint_detection_threshold(self, effects: SelectedEffects, owns: Sequence[EffectPrior]) -> float:
        """The same of several effects of one kind, tested as one: each alone may be too weak."""
        kind, log_trials, dof, undetermined = effects[0][0], 0.0, 0.0, 0.0
        if len(effects) < 2 or kind.name not in COMPANIONS or any(c.name != kind.name for c, _ in effects):
            return np.inf
        for j, ((candidate, hyper), own) in enumerate(zip(effects, owns, strict=True)):
            statistic, determined = own.detection_statistic
            log_trials += np.log(self.independent_trials(candidate, hyper, [c for c, _ in effects[:j]]) / (j + 1))
            dof, undetermined = dof + determined, undetermined + own.gain - statistic
        return _threshold(round(dof, 1), round(log_trials, 1), self.false_alarm_rate(kind)) + undetermined

    def occam_penalty(self, candidate: Candidate, hyper: float | None, present: Collection[Candidate], own: EffectPrior) -> float:
        """Twice the log of one over the candidate's share of the prior, and of what its coefficients could have fitted."""
        kinds = 1.0 if is_companion(candidate, present) else KINDS
        share = 2 * np.log(self.independent_trials(candidate, hyper, present) * kinds)
        return share + own.occam_penalty + further_effect_penalty(candidate, present)


def false_alarm_share(candidate: Candidate) -> float:
    """Share of the false-alarm rate given to one candidate, relative to that of an effect of one coefficient."""
    return float(candidate.k**-SHARE_POWER)


def is_companion(candidate: Candidate, present: Collection[Candidate]) -> bool:
    """Whether what is present makes this one likely: many joints of an arm are of one make."""
    return candidate.name in COMPANIONS and any(c.name == candidate.name for c in present)


def further_effect_penalty(candidate: Candidate, present: Collection[Candidate]) -> float:
    return FURTHER_EFFECT if present and not is_companion(candidate, present) else 0.0


@lru_cache(maxsize=10000)
def _threshold(dof: float, log_trials: float, rate: float) -> float:
    return float(chdtri(dof, min(rate / np.exp(log_trials), 0.2)))
