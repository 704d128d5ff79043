"""``none`` is said only of a recording that could have shown something; otherwise the number of poses that could."""

import re
from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.output.sufficient_poses import excluded_share, says_too_little, sufficient_poses
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_set import Member


@pytest.fixture(scope="module")
def few():
    """Twelve poses at two places of an artefact and two of a bar."""
    plan = simulated.plan(2, 2, 4)
    return simulated.observe(plan.select(np.isin(np.arange(plan.n_poses), np.linspace(0, plan.n_poses - 1, 12).round())), 5)


@pytest.fixture(scope="module")
def some_effect(few):
    return next(c for c in prepare(few).candidates if c.name == "joint_compliance")


def limited(candidate, **limits):
    """Effects of these kinds, each at locations with these limits in typical sizes."""
    return [
        Member(replace(candidate, name=kind), None, coefficients=size * candidate.typical)
        for kind, sizes in limits.items()
        for size in sizes
    ]


def test_kinds_count_alike_whatever_their_number_of_locations(some_effect):
    assert excluded_share(limited(some_effect, a=[0.5], b=[2.0, 2.0, 2.0])) == pytest.approx(0.5)
    assert excluded_share(limited(some_effect, a=[0.5], b=[2.0, 0.9])) == pytest.approx(0.75)


def test_limits_fall_with_the_square_root_of_the_poses(some_effect):
    assert sufficient_poses(limited(some_effect, a=[3.0], b=[9.0]), 20) == 20 * 3**2
    assert sufficient_poses(limited(some_effect, a=[0.9], b=[9.0]), 20) == 20


def test_no_number_of_poses_shows_what_the_geometry_absorbs(some_effect):
    absorbed = limited(some_effect, a=[0.5], b=[np.inf], c=[np.inf])
    assert sufficient_poses(absorbed, 20) == np.inf
    assert "other postures" in str(says_too_little(absorbed, 20))


def test_twelve_poses_cannot_tell_and_say_how_many_could(few):
    found = diagnose(few)
    assert found.verdict == "cannot_tell"
    assert found.effects == ()
    (said,) = [note for note in found.notes if "would exclude half" in note]
    (enough,) = re.findall(r"(\d+) poses like these", said)
    assert int(enough) > 12
    (advice,) = found.advice
    assert "would not have shown" in advice.reason
    measured = np.degrees(few.q)  # nothing else is known to be within reach
    assert all(np.abs(measured - np.array(q)).max(axis=1).min() < 1e-3 for q in advice.poses_deg)
