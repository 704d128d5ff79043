"""How well the poses show an effect at each of its locations."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.detectability import with_detectability
from mbcacq.estimation.variance_components import first_noise

STATED = first_noise(simulated.plan().cell)


@pytest.fixture(scope="module")
def setup(plan):
    return prepare(plan)


def by_location(candidates, name):
    return {c.where[0]: c.detectability for c in candidates if c.name == name}


def test_elasticity_is_detectable_where_the_load_is(setup):
    elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
    light = [replace(elastic[1], typical=1e-4 * elastic[1].typical)]
    detectability = by_location(with_detectability(setup.linear, STATED, [elastic[0], *light]), "joint_compliance")

    assert detectability["A2"] > 0.9
    assert detectability["A3"] == pytest.approx(OPTIONS.least_detectability, abs=0.01)


def test_detectability_is_by_chi2_at_the_typical_size(setup):
    """Four of chi2 is the middle; a tenth of the noise makes a hundred times as much of it."""
    joints = [c for c in setup.candidates if c.name == "joint_scale"]
    tenth = replace(STATED, point=STATED.point / 10, joint=STATED.joint / 10)
    coarse, fine = (by_location(with_detectability(setup.linear, noise, joints), "joint_scale") for noise in (STATED, tenth))
    small = by_location(with_detectability(setup.linear, tenth, [replace(c, typical=c.typical / 10) for c in joints]), "joint_scale")

    for joint, one in coarse.items():
        seen = 4 * (one - OPTIONS.least_detectability) / (1 - one)
        assert 4 * (fine[joint] - OPTIONS.least_detectability) / (1 - fine[joint]) == pytest.approx(100 * seen, rel=0.02)
        assert small[joint] == pytest.approx(one, abs=1e-3)


def test_kinds_with_a_hyper_parameter_are_fully_detectable(setup):
    assert all(c.detectability == 1.0 for c in setup.candidates if c.name in ("gear_transmission_error", "ball_shift", "joint_step"))
    assert np.unique([c.detectability for c in setup.candidates if c.name == "joint_scale"]).size > 1
