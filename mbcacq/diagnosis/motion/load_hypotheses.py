"""Masses of the links, a balancer and a load on the flange as competing explanations of a torque.

The masses are described to 10 % and free within that, so over a small range of angles they stand for a balancer or for another load, and
these for them, although they differ beyond it. Where the second axis moved over a small part of its range and the masses did not fit their
description, the selected explanation is compared with the others by evidence. Their coefficients have a few sizes, and all else is fitted
with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.evidence.bayes_factor import log_set_bayes_factor
from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.motion.candidate_pool import CandidatePool
from mbcacq.diagnosis.motion.determination import canonical_correlation
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.noise import covariance
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.search.effect_set import Member

ARM = "arm"  # the masses of the links
SIZES = np.array([0.03, 0.1, 0.3, 1.0])  # of a coefficient's prior sigma, equally probable
NOT_EXCLUDED = 0.05  # odds, against what is reported, from which an explanation is an alternative
CONTRADICTED = float(np.log(20.0))  # log Bayes factor of other masses from which the description of the arm is contradicted
SMALLEST = 1e-12  # eigenvalue of a covariance in units of the prior: directions below are those of rounding


@dataclass(frozen=True)
class _Posterior:
    """Coefficients x with covariance V of the columns ``chosen``, whose priors have the standard deviation sigma."""

    chosen: np.ndarray
    x: np.ndarray
    V: np.ndarray
    sigma: np.ndarray

    @classmethod
    def of(cls, model: MotionModel, chosen: np.ndarray) -> _Posterior:
        store = model.store
        weights = model.weights(chosen)
        x = store.solve(store.normal(weights), chosen)
        spread = covariance(store, weights, chosen, x, NUMBERS.correlation_s)
        return cls(chosen, x, spread, np.array(store.prior)[chosen])

    def at(self, ids: np.ndarray) -> list[int]:
        position = {int(c): i for i, c in enumerate(self.chosen)}
        return [position[int(i)] for i in ids]

    def log_bayes_factor(self, ids: np.ndarray, positive: bool) -> float:
        """Log Bayes factor of these columns against none, averaged over sizes, by the normal likelihood that the posterior implies."""
        at = self.at(ids)
        sigma = self.sigma[at]
        inverse = np.linalg.inv(self.V[np.ix_(at, at)] / np.outer(sigma, sigma))
        values, vectors = np.linalg.eigh(inverse - np.eye(len(at)))  # what the data add to the prior
        A = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return log_set_bayes_factor(A, inverse @ (self.x[at] / sigma), [slice(0, len(at))], [SIZES], [positive])[0]

    def log_odds_of_other_masses(self, ids: np.ndarray) -> float:
        """Log Bayes factor of masses as free as stated against those of the description (Savage and Dickey)."""
        at = self.at(ids)
        sigma = self.sigma[at]
        values, vectors = np.linalg.eigh(self.V[np.ix_(at, at)] / np.outer(sigma, sigma))
        values = np.clip(values, SMALLEST, 1.0)
        return float(0.5 * np.sum((vectors.T @ (self.x[at] / sigma)) ** 2 / values + np.log(values)))


def load_alternatives(model: MotionModel, pool: CandidatePool) -> list[NotSeparable]:
    """Other loads of the arm: the recordings do not exclude them in favour of the loads that were selected, or of the masses alone."""
    if not _asked(model):
        return []
    posterior = _Posterior.of(model, model.chosen())
    masses = model.store.base[len(model.group.joints) : -model.runs[0].q.shape[1]]
    if posterior.log_odds_of_other_masses(masses) < CONTRADICTED:
        return []
    out, there = [], {e.candidate.location for e in model.selected}
    for name in dict.fromkeys(c.name for c in pool.candidates if c.rows.load_parameters):
        own = [e for e in model.selected if e.candidate.name == name and e.candidate.rows.usual]
        variants = own or [
            v for variants in pool.usual() for v in variants if v.candidate.name == name and v.candidate.location not in there
        ]
        compared = [_compared(model, v, masses, selected=bool(own)) for v in variants if np.isfinite(v.candidate.rows.sigma).all()]
        if compared:
            odds = float(np.mean([odds for odds, _ in compared]))
            label = variants[0].candidate.label
            pair = (label, ARM) if own else (ARM, label)
            out.append(NotSeparable(pair, max(correlation for _, correlation in compared), min(odds, 1.0)))
    return [a for a in out if a.odds is not None and a.odds > NOT_EXCLUDED]


def _asked(model: MotionModel) -> bool:
    """The masses are described, and the second axis moved over a small part of its range."""
    robot, group = model.runs[0].robot, model.group
    if group.name != "tau" or 1 not in group.joints or robot is None or not robot.mass.any():
        return False
    low, high = (f([f(run.q[:, 1]) for run in model.runs]) for f in (np.min, np.max))
    return bool(high - low < NUMBERS.wide_range * np.ptp(robot.limits[1]))


def _compared(model: MotionModel, member: Member, masses: np.ndarray, selected: bool) -> tuple[float, float]:
    """Odds of the alternative (without the effect where it is selected, else with it), and the correlation of its estimate with the
    masses'."""
    chosen = model.chosen() if selected else np.concatenate([model.chosen(), member.columns]).astype(int)
    posterior = _Posterior.of(model, chosen)
    ids = member.columns[: member.candidate.rows.tested or len(member.columns)]
    log_factor = posterior.log_bayes_factor(ids, member.candidate.positive)
    odds = float(np.exp(np.clip(-log_factor if selected else log_factor, -700.0, 700.0)))
    return odds, canonical_correlation(posterior.V, posterior.at(ids), posterior.at(masses))
