"""Prior of an effect of several coefficients, by the directions in which the data determine them well or hardly.

Coefficients are random with standard deviations in proportion to their typical sizes, all of one scale, which is the most probable one
(empirical Bayes). A direction that the data hardly determine then has next to no Occam penalty and next to no weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.effects.effect import Candidate

SCALES = np.geomspace(0.05, 1e10, 90)  # of the best determined direction: variance of its coefficient to that of its noise
JUST_FOUND = 10.0  # the same of an effect just about to be found


@dataclass(frozen=True)
class EffectPrior:
    """gains: chi2 along each direction (k,). information: (k,) on the coefficients, in units of their typical sizes."""

    gains: np.ndarray
    information: np.ndarray

    @classmethod
    def of(cls, candidate: Candidate, coefficients: np.ndarray, covariance: np.ndarray) -> EffectPrior:
        """From coefficients (k,) and their covariance together with whatever else is fitted."""
        if candidate.k == 1:
            variance = max(float(covariance[0, 0]), 1e-300)
            return cls(coefficients**2 / variance, np.array([candidate.typical[0] ** 2 / variance]))
        variance, along = np.linalg.eigh(covariance / np.outer(candidate.typical, candidate.typical))
        there = variance > 1e-12 * variance[-1]
        z = (coefficients / candidate.typical) @ along[:, there]
        return cls(z**2 / variance[there], 1.0 / variance[there])

    @property
    def equally_determined(self) -> EffectPrior:
        """The same, were all directions determined equally well."""
        return EffectPrior(self.gains, np.ones_like(self.gains))

    @property
    def gain(self) -> float:
        """chi2 of all directions together."""
        return float(self.gains.sum())

    @cached_property
    def _most_probable(self) -> tuple[float, float]:
        """Of all scales: variance of the best determined coefficient to that of its noise, and twice the log evidence there."""
        if len(self.gains) == 1:
            return (self.gain - 1.0, self.gain - 1.0 - np.log(self.gain)) if self.gain > 1.0 else (0.0, 0.0)
        x = np.outer(SCALES, self.information / self.information.max())
        twice = x / (1 + x) @ self.gains - np.log1p(x).sum(axis=1)
        best = int(np.argmax(twice))
        return (float(SCALES[best]), float(twice[best])) if twice[best] > 0 else (0.0, 0.0)

    @property
    def scale(self) -> float:
        """Most probable size of the coefficients, in typical ones."""
        return float(np.sqrt(self._most_probable[0] / self.information.max()))

    @property
    def occam_penalty(self) -> float:
        """Gain less twice the log evidence: what the coefficients could have fitted besides."""
        return self.gain - self._most_probable[1]

    @cached_property
    def detection_statistic(self) -> tuple[float, float]:
        """Statistic and degrees of freedom: directions by the share of their gain that is believed of an effect just about to be found.

        Under noise alone the sum is nearly chi2 of these: a shifted and scaled one with the same first three moments (Pearson 1959).
        """
        if len(self.gains) == 1:
            return self.gain, 1.0
        x = JUST_FOUND * self.information / self.information.max()
        share = x / (1 + x)
        one, two, three = share.sum(), share @ share, (share**2) @ share
        dof = float(two**3 / three**2)
        return float((share @ self.gains - one) * two / three) + dof, dof
