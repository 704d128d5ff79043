"""Poses and motion of one run are one problem: evidences add, and what neither decides alone is decided by both."""

import numpy as np
import pytest

from mbcacq.diagnosis.motion.combine import _distance
from mbcacq.diagnosis.motion.joint_sets import EvidenceSets, joint_sets, not_excluded

TOOL, SOFT, BALANCER, PLAY = "payload:mount", "joint_compliance:A2", "gravity_compensator:A2", "backlash:A4"


def kilograms(value, std=0.1):
    return {"mass_kg": {"value": value, "std": std}}


# At standstill a tool and elastic joints act alike, in motion a tool is like masses of the links; backlash is seen by both, a little each.
POSES = EvidenceSets((0.0, -2.0, -2.0), ({TOOL: kilograms(12.0), PLAY: {}}, {SOFT: {}, PLAY: {}}, {TOOL: kilograms(12.0)}))
MOTION = EvidenceSets(
    (0.0, -2.0, -2.0), ({TOOL: kilograms(12.1), BALANCER: {}, PLAY: {}}, {BALANCER: {}, PLAY: {}}, {TOOL: kilograms(12.1), BALANCER: {}})
)


def alone(evidence):
    return not_excluded(joint_sets([evidence], _distance))


def test_what_each_alone_cannot_tell_is_named_by_both():
    """A tool, a balancer and backlash. Odds of 7 : 1 for the tool and for the backlash in each become 43 : 1 in both."""
    assert [s.effects for s in alone(POSES)] == [(PLAY, SOFT)]
    both = joint_sets([POSES, MOTION], _distance)
    assert both[0].effects == tuple(sorted([TOOL, BALANCER, PLAY]))
    assert not_excluded(both) == ()
    agreed = 0.5 * 0.1**2 / (2 * 0.1**2)  # 12.0 and 12.1 kg are 0.7 combined sigmas apart
    log_odds = {s.effects: s.log_odds for s in both}
    assert log_odds[tuple(sorted([SOFT, BALANCER, PLAY]))] == pytest.approx(-4.0 + agreed)
    assert log_odds[tuple(sorted([TOOL, BALANCER]))] == pytest.approx(-4.0)
    assert np.exp(4.0) > 20.0 > np.exp(2.0)


def test_values_that_contradict_each_other_make_a_set_improbable():
    motion = EvidenceSets((0.0, -3.0), ({TOOL: kilograms(15.0)}, {BALANCER: {}}))
    poses = EvidenceSets((0.0, -4.0), ({TOOL: kilograms(12.0)}, {SOFT: {}}))
    both = joint_sets([poses, motion], _distance)
    assert both[0].effects == tuple(sorted([SOFT, BALANCER]))
    same = joint_sets([poses, EvidenceSets((0.0, -3.0), ({TOOL: kilograms(12.1)}, {BALANCER: {}}))], _distance)
    assert same[0].effects == (TOOL,)


def test_an_effect_that_one_has_in_every_set_and_the_other_in_none_that_knows_it_leaves_no_joint_set():
    poses, motion = EvidenceSets((0.0,), ({TOOL: {}},)), EvidenceSets((0.0, -900.0), ({}, {TOOL: {}}))
    assert [s.effects for s in joint_sets([poses, motion], _distance)] == [(TOOL,)]
    assert joint_sets([poses, EvidenceSets((0.0,), ({},))], _distance)[0].effects == (TOOL,)
