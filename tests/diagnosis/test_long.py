"""A recording of more poses than can be searched as a whole: names keep what they explain though smooth groups stand beside them."""

import made
import pytest

from mbcacq.diagnosis.diagnose import diagnose


@pytest.fixture(scope="module")
def told():
    plan = made.plan(stations=24, bars=8, each=12)
    return diagnose(
        made.observe(
            plan,
            151,
            [
                ("gear_transmission_error", ("A1",), [1.5e-4, 1e-4], 13.4),
                ("gear_transmission_error", ("A1",), [0.0, 1.2e-4], 23.0),
                ("gear_transmission_error", ("A3",), [1.5e-4, 0.0], 15.1),
            ],
        )
    )


def test_the_orders_of_two_gears_are_named_and_explain_nearly_all(told):
    assert told.verdict in ("explained", "partly_explained")
    assert told.effects[0].name == "gear_transmission_error"
    assert set(told.effects[0].where) == {"A1", "A3"}
    assert told.effects[0].held_out_gain > 0.9
    assert sorted(told.effects[0].parameters["A1.order"].value) == pytest.approx([13.4, 23.0], abs=0.1)


def test_several_orders_of_a_joint_are_one_place_of_the_mismatch(told):
    places = [(m.at, m.depends_on) for m in told.mismatch]
    assert places[0] == ("A1", "q1")
    assert len(places) == len(set(places))
    assert told.mismatch[0].share > 0.5
