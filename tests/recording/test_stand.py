"""A motorised stand is drawn where the plan puts its stations."""

from pathlib import Path

import numpy as np
import pytest

from mbcacq.recording.rrd.stand import StationStand, turning_axis

PLANS = Path(__file__).resolve().parents[2] / "plans"


def test_the_turntable_of_the_shipped_plan_turns_where_its_comment_says():
    stand = StationStand.of((PLANS / "kuka-lift.yaml").read_text())
    assert stand is not None
    np.testing.assert_allclose(stand.axis, [620, 0], atol=1.0)
    assert len(stand.places) == 11


@pytest.mark.parametrize("plan", ["kuka.yaml", "quick.yaml"])
def test_an_artefact_that_people_carry_has_no_stand(plan):
    assert StationStand.of((PLANS / plan).read_text()) is None


def test_text_that_is_no_plan_has_no_stand():
    assert StationStand.of("positioner: {driver: modbus}") is None
    assert StationStand.of(": [") is None


@pytest.mark.parametrize("points", [[[0, 0], [1, 0], [2, 0], [3, 0]], [[0, 0], [100, 0], [0, 100], [70, 100]], [[0, 0], [9, 0], [0, 9]]])
def test_stations_on_no_circle_have_no_axis(points):
    assert turning_axis(np.array(points, float)) is None


def test_four_stations_on_a_circle_turn_about_its_centre():
    angle = np.radians([10, 80, 200, 310])
    np.testing.assert_allclose(turning_axis(np.column_stack([500 + 140 * np.cos(angle), -30 + 140 * np.sin(angle)])), [500, -30], atol=1e-6)
