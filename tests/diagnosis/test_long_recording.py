"""A recording of more poses than can be searched as a whole: parametric effects keep what they explain."""

from dataclasses import replace

import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.effects import unmodelled


@pytest.fixture(scope="module")
def plan():
    """216 poses, which are long here already."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(unmodelled, "OPTIONS", replace(unmodelled.OPTIONS, many_poses=200))
        plan = simulated.plan(stations=14, bars=4, each=12)
        assert plan.n_poses > unmodelled.OPTIONS.many_poses
        yield plan


@pytest.fixture(scope="module")
def reported(plan):
    return diagnose(
        simulated.observe(
            plan,
            151,
            [
                ("gear_transmission_error", ("A1",), [1.5e-4, 1e-4], 13.4),
                ("gear_transmission_error", ("A1",), [0.0, 1.2e-4], 23.0),
                ("gear_transmission_error", ("A3",), [1.5e-4, 0.0], 15.1),
            ],
        ),
        folds=2,
    )


def test_orders_of_two_gears_explain_nearly_all(reported):
    assert reported.verdict in ("explained", "partly_explained")
    assert reported.effects[0].name == "gear_transmission_error"
    assert set(reported.effects[0].where) == {"A1", "A3"}
    assert reported.effects[0].held_out_gain > 0.9
    assert sorted(reported.effects[0].parameters["A1.order"].value) == pytest.approx([13.4, 23.0], abs=0.1)


def test_halves_that_share_no_pose_show_both_gears_again(reported):
    found = {one.at: one for one in reported.effects[0].found_again}
    assert set(found) == {"A1", "A3"}
    assert all((one.found_in, one.parts, one.disjoint) == (2, 2, True) for one in found.values())
    for half in found["A3"].values["A3.order"]:
        assert half.value == pytest.approx(15.1, abs=0.1)
    assert all(one.determined for one in reported.effects[0].orders)


def test_several_orders_of_a_joint_are_one_location(reported):
    locations = [(m.at, m.depends_on) for m in reported.mismatch]
    assert locations[0] == ("A1", "q1")
    assert len(locations) == len(set(locations))
    assert reported.mismatch[0].share > 0.5


def test_noise_alone_is_no_random_effect(plan):
    """In a long recording random effects may stand at all locations, but only where their evidence outweighs their prior."""
    found = model_fit.fit_model(prepare(simulated.observe(plan, 152)))

    assert verdict_of(found) == "none"
    assert found.empty
