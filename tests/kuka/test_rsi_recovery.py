"""After an emergency stop: acknowledge, start the controller's program again, and the run goes on where it was."""

import numpy as np
import pytest
from kuka_bench import HOME_DEG, LIMITS_DEG, arrive, motion_limits, until_error, wait
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.server import FakeKrc
from mbcacq_kuka.rsi.driver import KukaRsi
from mbcacq_kuka.rsi.options import parse
from mbcacq_kuka.rsi.recovery import PendingMove, off_path
from mbcacq_kuka.rsi.shared import MOVE, RsiCommand

from mbcacq.devices import ConfigError, DeviceTimeout

FAR = np.radians(HOME_DEG + [60.0, 20.0, 0.0, 0.0, 0.0, 0.0])


def test_a_motion_that_an_emergency_stop_interrupted_is_ended_after_the_restart(cell, caplog):
    krc, robot = cell({"rearm_s": 1.5}, {"silence_s": 0.5, "recover_s": 100.0})
    robot.move_to(FAR, motion_limits(speed=20.0))
    wait(lambda: np.degrees(robot.state().q[0]) > 5.0)
    krc.inject(stop=1)
    state = arrive(robot)
    np.testing.assert_allclose(state.q, FAR, atol=2e-4)
    assert krc.counters()["sessions"] == 2
    assert "acknowledge, start the RSI program again" in caplog.text
    first, second = robot.cycles().columns, robot.cycles().columns
    assert np.degrees(first["q"][-1, 0]) < 59.0 < np.degrees(second["q"][-1, 0])
    robot.move_to(np.radians(HOME_DEG), motion_limits())
    np.testing.assert_allclose(arrive(robot).q, np.radians(HOME_DEG), atol=2e-4)


def test_an_arm_that_stood_goes_on_standing(cell):
    krc, robot = cell({"rearm_s": 1.5}, {"silence_s": 0.5, "recover_s": 100.0})
    target = np.radians(HOME_DEG + [2.0, 0, 0, 0, 0, 0])
    robot.move_to(target, motion_limits())
    arrive(robot)
    krc.inject(stop=1)
    wait(lambda: krc.counters()["sessions"] == 2)
    np.testing.assert_allclose(arrive(robot).q, target, atol=2e-4)


def test_a_program_that_is_not_started_again_ends_the_run(cell):
    krc, robot = cell({"rearm_s": 1000.0}, {"silence_s": 0.5, "recover_s": 1.0})
    robot.move_to(FAR, motion_limits(speed=20.0))
    krc.inject(stop=1)
    error = until_error(robot)
    assert type(error) is DeviceTimeout
    assert "no telegram for" in str(error)
    assert "it could not go on" in str(error)


def test_an_arm_that_was_moved_meanwhile_does_not_go_on():
    port = free_port()
    options = {"limits_deg": LIMITS_DEG, "port": port, "silence_s": 0.5, "recover_s": 100.0}
    common = {"client": ("127.0.0.1", port), "realtime": False, "limits_deg": LIMITS_DEG}
    with FakeKrc(**common, start_deg=tuple(HOME_DEG)) as krc:
        robot = KukaRsi("arm", "", options)
        robot.connect()
        robot.move_to(FAR, motion_limits(speed=20.0))
        wait(lambda: np.degrees(robot.state().q[0]) > 5.0)
        krc.stop()
    with FakeKrc(**common, start_deg=tuple(HOME_DEG + [10.0, 0.0, 9.0, 0.0, 0.0, 0.0])):
        error = until_error(robot)
        assert type(error) is DeviceTimeout
        assert "A3 stands 9.00° off the path" in str(error)
    robot.close()


def pending():
    return PendingMove(np.array(HOME_DEG), np.degrees(FAR), RsiCommand(MOVE))


@pytest.mark.parametrize(
    ("now", "fine"),
    [
        ([30.0, 10.0, 0.0, 0.0, 0.0, 0.0], True),
        ([30.5, 10.9, 0.0, 0.0, 0.0, 0.0], True),
        ([30.0, 12.0, 0.0, 0.0, 0.0, 0.0], False),
        ([-3.0, 0.0, 0.0, 0.0, 0.0, 0.0], False),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 2.0], False),
    ],
)
def test_the_arm_must_stand_on_the_path_that_was_interrupted(now, fine):
    assert (off_path(HOME_DEG + now, HOME_DEG, pending()) == "") is fine


def test_an_arm_without_a_motion_must_stand_where_it_stood():
    assert off_path(HOME_DEG + 0.5, HOME_DEG, None) == ""
    assert off_path(HOME_DEG + 1.5, HOME_DEG, None) != ""


def test_over_eki_a_person_must_start_the_program():
    with pytest.raises(ConfigError, match="eki and recover_s exclude each other"):
        parse("arm", {"limits_deg": LIMITS_DEG, "eki": "127.0.0.1:54600", "recover_s": 60.0})


def test_external_axes_are_recorded_where_they_are_sent(cell):
    _, robot = cell({"layout": "sdk", "external_deg": (1.0, -2.0, 3.0, 4.5, 0.0, 6.0)})
    columns = robot.cycles().columns
    np.testing.assert_allclose(columns["external_axes"], np.tile([1.0, -2.0, 3.0, 4.5, 0.0, 6.0], (len(columns["ipoc"]), 1)))
    assert "external_axes" in {field.name for field in robot.describe().fields}
