"""Which effects enter the search of a long recording in one round: those that are apart, not several names of one thing."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.evidence.hypothesis import SetPrior, estimated
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.pose_search import SHARE_OF_ODDS, PoseSearch
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.problem import prepare
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.variance_components import pack


def entering(obs):
    """The effects that enter beyond none, and the possible ones with their log odds."""
    problem = prepare(obs, CalibrationOptions())
    blocks = UnmodelledEffects(problem.design_blocks)
    search = PoseSearch(
        candidates=problem.candidates,
        prior=SetPrior.of(problem.candidates, len(blocks.design_blocks.locations)),
        unmodelled=blocks,
        context=problem.context,
        staged=True,
    )
    none = estimated((), NoisePoint(problem.linear, problem.prior_noise, pack(problem.noise)), 0.0)
    possible = search.extensions(none, problem.candidates)
    return search.together(none, possible), possible


@pytest.fixture(scope="module")
def plan():
    return simulated.plan(stations=12, bars=6, each=10)


def test_orders_of_two_gears_enter_together(plan):
    orders = [("gear_transmission_error", ("A1",), [1.8e-4, 1e-4], 13.4), ("gear_transmission_error", ("A4",), [2.5e-4, 0.0], 17.1)]
    found, _ = entering(simulated.observe(plan, 161, orders))
    assert {(m.candidate.where, round(m.value)) for m in found} == {(("A1",), 13), (("A4",), 17)}


def test_another_name_of_the_same_thing_does_not_enter_with_it(plan):
    """An elastic base turns the arm nearly as an elastic joint A2 does."""
    found, possible = entering(simulated.observe(plan, 162, [("base_compliance", ("base",), [1e-6], None)]))
    rivals = {m.label for log, m in possible if log > SHARE_OF_ODDS * possible[0][0] and m.candidate.where != ("base",)}
    assert "joint_compliance:A2" in rivals
    assert [m.label for m in found] == ["base_compliance:base"]


def test_nothing_enters_where_nothing_is_probable(plan):
    found, possible = entering(simulated.observe(plan, 163))
    assert possible[0][0] < 0
    assert found == ()


def test_no_more_effects_enter_than_a_set_may_have(plan, monkeypatch):
    orders = [("gear_transmission_error", (f"A{i}",), list(2.5e-4 * np.array([np.cos(i), np.sin(i)])), 11.0 + i) for i in (1, 3, 4)]
    obs = simulated.observe(plan, 164, orders)
    assert len(entering(obs)[0]) == 3
    monkeypatch.setattr(PoseSearch, "most_effects", 2)
    assert len(entering(obs)[0]) == 2
