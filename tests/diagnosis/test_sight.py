"""How well the poses see an effect at each of its places."""

from dataclasses import replace

import numpy as np
import pytest

from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.detectability import LEAST, sighted


@pytest.fixture(scope="module")
def setup(plan):
    return prepare(plan)


def by_place(candidates, name):
    return {c.where[0]: c.detectability for c in candidates if c.name == name}


def test_elasticity_is_seen_where_the_load_is_and_not_where_there_is_a_ten_thousandth_of_it(setup):
    elastic = [c for c in setup.candidates if c.name == "joint_compliance"]
    light = [replace(elastic[1], typical=1e-4 * elastic[1].typical)]
    sight = by_place(sighted(setup.linear, setup.prior_noise, [elastic[0], *light]), "joint_compliance")

    assert sight["A2"] > 0.9
    assert sight["A3"] == pytest.approx(LEAST, abs=0.01)


def test_what_is_seen_is_chi2_at_its_typical_size(setup):
    """Four of chi2 is the middle; a tenth of the noise makes a hundred times as much of it."""
    joints = [c for c in setup.candidates if c.name == "joint_scale"]
    tenth = replace(setup.prior_noise, point=setup.prior_noise.point / 10, joint=setup.prior_noise.joint / 10)
    coarse, fine = (by_place(sighted(setup.linear, noise, joints), "joint_scale") for noise in (setup.prior_noise, tenth))
    small = by_place(sighted(setup.linear, tenth, [replace(c, typical=c.typical / 10) for c in joints]), "joint_scale")

    for joint, one in coarse.items():
        seen = 4 * (one - LEAST) / (1 - one)
        assert 4 * (fine[joint] - LEAST) / (1 - fine[joint]) == pytest.approx(100 * seen, rel=0.02)
        assert small[joint] == pytest.approx(one, abs=1e-3)


def test_a_kind_with_a_value_to_be_sought_is_left_alone(setup):
    assert all(c.detectability == 1.0 for c in setup.candidates if c.name in ("gear_transmission_error", "ball_shift", "joint_step"))
    assert np.unique([c.detectability for c in setup.candidates if c.name == "joint_scale"]).size > 1
