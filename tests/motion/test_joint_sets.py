"""Poses and motion of one run are one problem: what neither decides or shows alone is decided and shown by both."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mbcacq.diagnosis.findings import ComparedEffect, ComparedSet, EvidenceSummary
from mbcacq.diagnosis.motion.joint_sets import joint_evidence, log_of_one, not_excluded
from mbcacq.effects.effect import number

TOOL, SOFT, BALANCER, PLAY = "payload:mount", "joint_compliance:A2", "gravity_compensator:A2", "backlash:A4"
PRIOR = 8.0  # kg, of a tool


def effect(parameters, prior=None, log_prior=0.0):
    """What a set states of an effect, of whatever name."""
    return lambda name, *where: ComparedEffect(name, where, parameters, True, prior or {}, log_prior)


def evidence(log_odds, sets):
    """Of sets by the labels of their effects; of its priors nothing is known."""
    each = [tuple(states(*label.split(":")) for label, states in one.items()) for one in sets]
    return EvidenceSummary(0, np.nan, 0.0, tuple(map(ComparedSet, each, log_odds)))


def kilograms(value, std=0.1, log_prior=-3.0):
    return effect({"mass_kg": number(value, std)}, {"mass_kg": number(10.0, PRIOR)}, log_prior)


NOTHING_STATED = effect({})

# At standstill a tool and elastic joints act alike, in motion a tool is like masses of the links; backlash is seen by both, a little each.
POSES = evidence(
    (0.0, -2.0, -2.0),
    ({TOOL: kilograms(12.0), PLAY: NOTHING_STATED}, {SOFT: NOTHING_STATED, PLAY: NOTHING_STATED}, {TOOL: kilograms(12.0)}),
)
MOTION = evidence(
    (0.0, -2.0, -2.0),
    (
        {TOOL: kilograms(12.1), BALANCER: NOTHING_STATED, PLAY: NOTHING_STATED},
        {BALANCER: NOTHING_STATED, PLAY: NOTHING_STATED},
        {TOOL: kilograms(12.1), BALANCER: NOTHING_STATED},
    ),
)


def test_what_each_alone_cannot_tell_is_named_by_both():
    """A tool, a balancer and backlash. Odds of 7 : 1 for the tool and for the backlash in each become far more in both."""
    alone = joint_evidence([POSES])
    assert [s.effects for s in not_excluded(alone.sets)] == [(PLAY, SOFT)]
    assert not alone.decided
    both = joint_evidence([POSES, MOTION])
    assert both.sets[0].effects == tuple(sorted([TOOL, BALANCER, PLAY]))
    assert both.decided
    log_odds = {s.effects: s.log_odds for s in both.sets}
    assert log_odds[tuple(sorted([TOOL, BALANCER]))] == pytest.approx(-4.0)


def test_values_that_contradict_each_other_make_a_set_improbable():
    motion = evidence((0.0, -3.0), ({TOOL: kilograms(15.0)}, {BALANCER: NOTHING_STATED}))
    poses = evidence((0.0, -4.0), ({TOOL: kilograms(12.0)}, {SOFT: NOTHING_STATED}))
    assert joint_evidence([poses, motion]).sets[0].effects == tuple(sorted([SOFT, BALANCER]))
    same = joint_evidence([poses, evidence((0.0, -3.0), ({TOOL: kilograms(12.1)}, {BALANCER: NOTHING_STATED}))])
    assert same.sets[0].effects == (TOOL,)


def test_an_effect_that_one_has_in_every_set_and_the_other_in_none_that_knows_it_leaves_no_joint_set():
    poses, motion = evidence((0.0,), ({TOOL: NOTHING_STATED},)), evidence((0.0, -900.0), ({}, {TOOL: NOTHING_STATED}))
    assert [s.effects for s in joint_evidence([poses, motion]).sets] == [(TOOL,)]
    assert joint_evidence([poses, evidence((0.0,), ({},))]).sets[0].effects == (TOOL,)


def log_evidence(X, y, prior_std):
    """Log density of rows y = X c + noise of unit variance, about a coefficient c ~ N(0, prior_std^2), computed from the rows themselves."""
    return multivariate_normal.logpdf(y, np.zeros(len(y)), np.eye(len(y)) + prior_std**2 * np.outer(X, X))


def stated(X, y, prior_std, log_prior):
    """Posterior of that coefficient as a kilogram beyond 5 kg."""
    variance = 1 / (X @ X + prior_std**-2)
    entry = number(5.0 + variance * (X @ y), np.sqrt(variance))
    return effect({"mass_kg": entry}, {"mass_kg": number(5.0, prior_std)}, log_prior)


@pytest.mark.parametrize("true", [0.3, 2.5])
def test_joint_evidence_is_that_of_all_rows_with_one_coefficient(true):
    """Rows of two kinds with one coefficient, at a tool that neither shows by itself: the evidence of all of them in one vector."""
    rng = np.random.default_rng(4)
    X, Z, size, log_prior = rng.normal(size=9), rng.normal(size=14), 3.0, -2.3
    y, z = X * true + rng.normal(size=9), Z * true + rng.normal(size=14)

    def log_odds(X, y):
        return log_evidence(X, y, size) - multivariate_normal.logpdf(y, np.zeros(len(y)), np.eye(len(y))) + log_prior

    sets = [evidence((log_odds(*rows), 0.0), ({TOOL: stated(*rows, size, log_prior)}, {})) for rows in ((X, y), (Z, z))]
    both = joint_evidence(sets)
    expected = log_odds(np.r_[X, Z], np.r_[y, z])  # one prior, one coefficient
    assert both.log_e_value == pytest.approx(expected, abs=1e-9)
    of = {s.effects: s.log_odds for s in both.sets}
    assert of[TOOL,] - of[()] == pytest.approx(expected, abs=1e-9)


def test_what_neither_shows_alone_is_shown_by_both():
    rng = np.random.default_rng(7)
    size, log_prior = 3.0, -2.3
    rows = [(X, X * 1.45 + rng.normal(size=len(X))) for X in (rng.normal(size=9), rng.normal(size=10))]

    def log_odds(X, y):
        return log_evidence(X, y, size) - multivariate_normal.logpdf(y, np.zeros(len(y)), np.eye(len(y))) + log_prior

    sets = [evidence((log_odds(*one), 0.0), ({TOOL: stated(*one, size, log_prior)}, {})) for one in rows]
    assert not any(joint_evidence([one]).significant for one in sets)
    assert joint_evidence(sets).significant
    assert joint_evidence(sets).reported == (TOOL,)


def test_a_phase_is_compared_the_shorter_way_round_and_has_no_wider_prior_than_a_turn():
    def wave(phase):
        entries = {"A4.order": number(2.0, 0.1), "A4.phase_deg": number(phase, 3.0)}
        return effect(entries, {"A4.phase_deg": number(0.0, 1e6)}, 0.0)("encoder_error", "A4")

    near, far = log_of_one([wave(179.0), wave(-179.5)]), log_of_one([wave(179.0), wave(0.0)])
    combined = 3.0 * np.sqrt(2.0)
    assert near == pytest.approx(np.log(360 / np.sqrt(12) / combined) - 0.5 * (1.5 / combined) ** 2, abs=0.01)
    assert far < -800


def test_without_priors_half_the_squared_distance_is_taken_off():
    one, other = (effect({"mass_kg": number(v, 0.1)})("payload", "mount") for v in (12.0, 12.1))
    assert log_of_one([one, other]) == pytest.approx(-0.25)
