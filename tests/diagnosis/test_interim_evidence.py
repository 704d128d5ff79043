"""A look at the evidence: one threshold for any number of poses, odds of what was compared, and of what was not tried."""

from __future__ import annotations

import json

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.evidence.beam_search import LEAST_LOG_E_VALUE
from mbcacq.diagnosis.interim import weigh
from mbcacq.effects.catalogue import candidates
from mbcacq.effects.untried import untried
from mbcacq.errors import CalibrationError
from mbcacq.estimation.forward_model import Displacements
from mbcacq.model.json_text import plain

AMPLITUDE = 3e-4  # rad


def once_a_turn_of_joint_two(context):
    joint = np.zeros(context.obs.q.shape)
    joint[:, 1] = AMPLITUDE * np.sin(context.obs.q[:, 1] + 1.9)
    return Displacements(joint=joint)


@pytest.fixture(scope="module")
def postures():
    """Over 105 deg of A2, less than a third of a turn."""
    rng, limits = np.random.default_rng(3), simulated.robot().limits
    q = np.clip(rng.uniform(0.5 * limits[:, 0], 0.5 * limits[:, 1], (40, 6)), -2.2, 2.2)
    q[:, 1] = np.radians(rng.uniform(-130.0, -25.0, len(q)))
    return q


@pytest.fixture(scope="module")
def slow_error(postures):
    return weigh(simulated.observe(simulated.tracked(postures), 21, [once_a_turn_of_joint_two]))


def test_an_order_that_the_travel_does_not_cover_is_known_to_be_untried(slow_error):
    context = slow_error.problem.context
    found = {(u.name, u.candidate.where): u.reason for u in untried(context, candidates(context)[0])}
    assert "order 1 is not tried over 10" in found["gear_transmission_error", ("A2",)]


def test_an_error_once_a_turn_is_never_explained_by_a_name_that_is_not_its_own(slow_error):
    assert slow_error.summary.significant
    named = {effect.name for effect in slow_error.summary.sets[0].effects if effect.tried}
    assert slow_error.verdict != "explained" or named <= {"gear_transmission_error"}


def test_sets_come_with_odds_and_coefficients_and_as_json(slow_error):
    summary = slow_error.summary
    odds = [one.log_odds for one in summary.sets]
    assert odds[0] == 0.0
    assert odds == sorted(odds, reverse=True)
    assert () in [one.effects for one in summary.sets]
    json.dumps(plain(summary), allow_nan=False)


@pytest.mark.parametrize("poses", [24, 40])
def test_one_threshold_holds_at_every_look(postures, poses):
    look = weigh(simulated.observe(simulated.tracked(postures), 22).select(np.arange(40) < poses))
    assert look.summary.least_log_e_value == pytest.approx(np.log(100.0)) == LEAST_LOG_E_VALUE
    assert not look.summary.significant
    assert look.summary.sets[0].effects == ()


def test_too_few_poses_are_refused(postures):
    with pytest.raises(CalibrationError, match="too few for a diagnosis"):
        weigh(simulated.observe(simulated.tracked(postures), 22).select(np.arange(40) < 8))
