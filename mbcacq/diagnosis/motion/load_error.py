"""Error of the torque that passes the gears, which is itself an estimate: it belongs to the noise of every mismatch that follows the load.

The load of an explained joint is the torque of the links and of the effects behind its gear, whose coefficients have a covariance. With a
root of that, the error of the load is a sum of columns, common to all joints, with coefficients of mean 0 and standard deviation 1. On the
joint side an elastic gear passes it on as compliance times these columns. They are in the base of that channel with their prior (errors in
variables, to first order). Without them their structure would pass for an effect, and compliances for exact.

The load itself has competing explanations: the masses of the links, a balancer, a load on the flange. The masses are described to 10 % and
free within that, so over a small range of angles they stand for a balancer or for another load, and these for them, although they differ
beyond it. The selected explanation is compared with the others by evidence if the second axis moved over a small part of its range and the
masses did not fit their description. Their coefficients have a few sizes, and all else is fitted with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.motion.candidate_pool import CandidatePool
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.noise import covariance
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.search.bayes_factor import log_set_bayes_factor
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.motion_effect import available

# Share of the error's variance of each joint that is left out. Thousands of angles show shapes of a wind-up that are a thousandth of the
# whole; with a hundredth left out, two of three short runs (benchmarks/run_and_motion.md) had a false name.
LEFT_OUT = 1e-7
LEAST_INFORMATION = 1e-3  # of a direction of the coefficients in units of their priors: below is rounding


def load_error(model: MotionModel, weights: np.ndarray) -> list[np.ndarray]:
    """(T, J, r) by run: what independent standard normal errors change of the load of each joint.

    weights: (J,) one over the variance of a sample.
    """
    group, runs = model.group, model.runs
    if group.name != "tau":
        return [np.zeros((len(run.q), len(group.joints), 0)) for run in runs]
    chosen = model.chosen()
    links = model.store.base[len(group.joints) : -runs[0].q.shape[1]]  # the first are offsets, the last the rotors
    passed = [e for e in model.selected if not catalogue.declaration(e.candidate.name).motor_side]
    ids = np.concatenate([links, *(e.columns for e in passed)]).astype(int)
    root = _root(model, weights, chosen)[model.store.positions(chosen)[ids]]
    out = []
    for k in range(len(runs)):
        each = (
            np.concatenate([group.base[k][:, j, : len(links)], *(model.columns_of(e, j, k) for e in passed)], axis=1) @ root
            for j in range(len(group.joints))
        )
        out.append(np.stack(list(each), axis=1))
    return _principal(out)


def _root(model: MotionModel, weights: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(c, c) root of the posterior covariance of the coefficients of these columns.

    The masses are known far less than the torque that they make together. So the root is that of the information, whose weakest directions
    make no torque; the inverse of a matrix would have that to its rounding only.
    """
    prior = np.array(model.store.prior)[chosen]
    information = model.store.normal(weights)[np.ix_(chosen, chosen)] + np.diag(prior**-2.0)
    scale = np.where(np.isfinite(prior), prior, 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300)))
    value, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    return scale[:, None] * vectors / np.sqrt(np.maximum(value, LEAST_INFORMATION))


def _principal(columns: list[np.ndarray]) -> list[np.ndarray]:
    """The same error of fewer columns (T, J, r), in order of their size relative to the error of each joint."""
    products = sum(np.einsum("tjr,tjs->jrs", one, one) for one in columns)
    size = np.einsum("jrr->j", products)
    together = np.einsum("jrs,j->rs", products, 1.0 / np.maximum(size, 1e-300))
    directions = np.linalg.eigh(together)[1][:, ::-1]
    kept = np.cumsum(np.einsum("rk,jrs,sk->jk", directions, products, directions), axis=1)
    enough = np.all(kept >= (1.0 - LEFT_OUT) * size[:, None], axis=0)
    most = int(np.argmax(enough)) + 1
    return [one @ directions[:, :most] for one in columns]


def follow_load_error(model: MotionModel) -> None:
    """Let the error of the load show as the selected effects pass it on."""
    if len(model.load_error):
        columns = _passed_on(model, model.coefficients())
        model.store.replace(model.load_error, list(range(len(columns))), columns)


def _passed_on(model: MotionModel, x: np.ndarray) -> list[np.ndarray]:
    """(Ttot, r) by joint of the group: how the error of the load shows in the mismatch through the selected effects.

    x: coefficients of ``model.chosen()``.
    """
    passing = [(e.candidate.rows, model.coefficients_of(e, x)) for e in model.selected if e.candidate.rows.linear_in_load]
    out = []
    for joint in model.group.joints:
        by_run = [np.zeros_like(available(run.load_error)[:, 0]) for run in model.runs]
        for rows, coefficients in passing:
            if joint in rows.joints:
                for run, columns in zip(model.runs, by_run, strict=True):
                    for r in range(columns.shape[1]):
                        moved = replace(run, load=available(run.load_error)[:, :, r])
                        columns[:, r] += rows.columns(moved, joint, None) @ coefficients
        out.append(np.concatenate(by_run))
    return out


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
        variants = own or [v for forms in pool.usual() for v in forms if v.candidate.name == name and v.candidate.location not in there]
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


def canonical_correlation(spread: np.ndarray, own: list[int], other: list[int]) -> float:
    """Largest canonical correlation between two sets of coefficients with covariance ``spread``."""
    one, two = (_whitener(spread[np.ix_(at, at)]) for at in (own, other))
    return float(np.clip(np.linalg.svd(one @ spread[np.ix_(own, other)] @ two.T, compute_uv=False)[0], 0.0, 1.0))


def _whitener(v: np.ndarray) -> np.ndarray:
    d = 1.0 / np.sqrt(np.maximum(np.diag(v), 1e-300))
    values, vectors = np.linalg.eigh(v * np.outer(d, d))
    good = values > 1e-8
    return (vectors[:, good] / np.sqrt(values[good])).T * d
