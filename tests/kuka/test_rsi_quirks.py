"""What real controllers and simulators do differently, and the driver takes as it comes."""

import numpy as np
import pytest
from kuka_bench import HOME_DEG, arrive, motion_limits, until_error, wait

from mbcacq.devices import DeviceFault, DeviceTimeout, ProtocolError

TARGET = np.radians(HOME_DEG + [3.1234, 1.0, 0, 0, 0, -2.7])


@pytest.mark.parametrize(
    "quirk",
    [
        {"faults": {"upper_type": 1}},
        {"faults": {"spaced": 1}},
        {"faults": {"spaced": 2}},
        {"faults": {"spaced": 3}},
        {"faults": {"swap": 1}},
        {"empty_first": 1},
        {"empty_first": 2},
        {"precision": 4},
        {"precision": 12},
        {"layout": "sdk"},
        {"layout": "minimal"},
        {"counting": "consecutive"},
        {"hold_on": False},
        {"faults": {"upper_type": 1, "spaced": 3, "swap": 1}, "empty_first": 2, "precision": 5, "counting": "consecutive"},
    ],
    ids=str,
)
def test_none_of_this_is_a_fault(cell, quirk):
    krc, robot = cell(quirk)
    robot.move_to(TARGET, motion_limits())
    np.testing.assert_allclose(arrive(robot).q, TARGET, atol=2e-4)
    np.testing.assert_allclose(krc.state.read().q, TARGET, atol=1e-5)


@pytest.mark.parametrize("decimals", [1, 2])
def test_too_few_decimals_are_named(cell, decimals):
    """With Precision 1, the default of the ETHERNET object, nobody can tell an arrival within a hundredth of a degree."""
    krc, robot = cell({"precision": decimals})
    robot.move_to(np.radians(HOME_DEG + [3.1234, 0, 0, 0, 0, 0]), motion_limits())
    if decimals == 2:  # within tolerance by luck of the rounding: an error of 0.0034 deg
        arrive(robot)
        return
    error = until_error(robot)
    assert type(error) is DeviceFault
    assert "1 decimal only" in str(error)
    assert "set Precision to 6" in str(error)


def test_a_nearly_empty_stream_is_not_a_session(cell):
    with pytest.raises(Exception, match="add DEF_AIPos"):
        cell({"empty_first": 500})


@pytest.mark.parametrize(
    ("counting", "late_limit", "kind"),
    [
        ("consecutive", 60, None),  # single losses never add up to the controller's end
        ("total", 60, (DeviceTimeout, ProtocolError)),  # the controller ends the session first, without a word, and may begin another
        ("total", 8, DeviceFault),  # we see its Delay rise and stop before it does
    ],
)
def test_lost_answers_counted_both_ways(cell, counting, late_limit, kind):
    krc, robot = cell({"counting": counting, "timeout": 12, "rearm_s": 0.2, "speed_deg_s": (95.0,) * 6}, {"late_limit": late_limit})
    krc.inject(drop_answers=0.1 if kind else 0.03)  # some 37 on the way, so that 12 are always among them; or each a pause of its own
    robot.move_to(np.radians(HOME_DEG + [100.0, 0, 0, 0, 0, 0]), motion_limits())
    if kind is None:
        np.testing.assert_allclose(np.degrees(arrive(robot).q[0]), 100.0, atol=0.02)
        assert krc.report()["late"] > 12
        assert krc.report()["sessions"] == 1
    else:
        error = until_error(robot)
        assert isinstance(error, kind)
        assert wait(lambda: krc.state.read().standstill)
        assert np.degrees(krc.state.read().q[0]) < 99.0


def test_external_axes_are_recorded_where_they_are_sent(cell):
    _, robot = cell({"layout": "sdk", "external_deg": (1.0, -2.0, 3.0, 4.5, 0.0, 6.0)})
    columns = robot.cycles().columns
    np.testing.assert_allclose(columns["external_axes"], np.tile([1.0, -2.0, 3.0, 4.5, 0.0, 6.0], (len(columns["ipoc"]), 1)))
    assert "external_axes" in {field.name for field in robot.describe().fields}
