"""An arm driven over EKI moves, turns, stops and stays within its limits."""

import threading
import time

import numpy as np
import pytest
from eki_arm import FAR, HOME, HOME_DEG, on_the_way, stands
from eki_bench import EKI_LIMITS_DEG, SYSTEMS
from kuka_bench import arrive, motion_limits, until_error

from mbcacq.devices import ConfigError, ConnectError, Robot, SafetyStop


@pytest.mark.parametrize("system", SYSTEMS)
def test_it_moves_and_arrives_when_the_arm_stands_there(eki_cell, system):
    fake, robot = eki_cell(system)
    assert isinstance(robot, Robot)
    target = HOME + np.radians([3.0, -2.0, 1.0, 4.0, -3.0, 2.0])
    robot.move_to(target, motion_limits(settle_s=0.2))
    state = arrive(robot)
    np.testing.assert_allclose(state.q, target, atol=2e-4)
    assert not state.moving
    assert fake.state.read().standstill
    columns = robot.cycles().columns
    np.testing.assert_allclose(columns["q_command"][-1], target, atol=1e-6)
    there = (np.abs(columns["q"] - target).max(axis=1) < 2e-4) & ~columns["moving"]
    first = columns["time_s"][there.argmax()]
    assert columns["time_s"][-1] - first >= 0.2  # stood there for the settling time, on the robot's clock
    cycles = np.diff(columns["time_s"]) / 0.012  # a busy computer reads the link less often, never between two cycles
    np.testing.assert_allclose(cycles, np.round(cycles), atol=1e-6)
    assert cycles.min() > 1.5
    assert robot.describe().serial.startswith("#KR10R1100_2")


def test_a_new_target_on_the_way_stops_and_turns(eki_cell):
    fake, robot = eki_cell()
    on_the_way(fake, robot)
    robot.move_to(HOME, motion_limits())
    arrive(robot)
    assert max(np.degrees(robot.cycles().columns["q"][:, 0])) < 4.0
    np.testing.assert_allclose(fake.state.read().q, HOME, atol=2e-4)


def test_speed_is_a_share_of_the_slowest_axis(eki_cell):
    """30 deg/s of an axis that makes 430 are 6 %: A1 then turns no faster than 6 % of its 200 deg/s."""
    fake, robot = eki_cell()
    robot.move_to(FAR, motion_limits(speed=30.0))
    arrive(robot)
    columns = robot.cycles().columns
    fastest = np.degrees(np.diff(columns["q"][:, 0]) / np.diff(columns["time_s"])).max()
    assert fastest == pytest.approx(0.04 * 200.0, rel=0.02)  # 30 of 630 deg/s, rounded down


def test_stop_from_anywhere_any_number_of_times(eki_cell):
    fake, robot = eki_cell()
    robot.stop()
    on_the_way(fake, robot)
    threads = [threading.Thread(target=lambda: [robot.stop() for _ in range(50)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert stands(fake)
    assert np.degrees(fake.state.read().q[0]) < 4.5
    assert not robot.state().arrived
    robot.move_to(HOME, motion_limits())
    arrive(robot)
    robot.stop()
    assert robot.state().arrived
    robot.close()
    robot.stop()
    robot.close()


def test_closing_on_the_way_waits_until_the_arm_stands(eki_cell):
    fake, robot = eki_cell()
    on_the_way(fake, robot)
    robot.close()
    assert fake.state.read().standstill
    assert np.degrees(fake.state.read().q[0]) < 4.8
    with pytest.raises(ConnectError, match="call connect first"):
        robot.state()
    fake.inject(override=100)
    robot.connect()
    robot.move_to(HOME, motion_limits())
    arrive(robot)


def test_the_controllers_own_limits_refuse_what_the_driver_would_allow(eki_cell):
    exact = {"encoder_noise_deg": 0.0, "encoder_step_deg": 0.0}  # its program holds the measured position, which else hums
    fake, robot = eki_cell(controller=exact, robot={"limits_deg": [(-20, 20)] + EKI_LIMITS_DEG[1:]})
    robot.move_to(np.radians(HOME_DEG + [10.0, 0, 0, 0, 0, 0]), motion_limits())
    error = until_error(robot)
    assert type(error) is SafetyStop
    assert "A1 would leave the limits written into its program" in str(error)
    np.testing.assert_allclose(fake.state.read().q, HOME, atol=1e-9)


def test_targets_outside_the_limits_move_nothing(eki_cell):
    fake, robot = eki_cell()
    for bad in (HOME + [np.radians(6), 0, 0, 0, 0, 0], HOME * np.nan):
        with pytest.raises(SafetyStop, match="nothing was moved"):
            robot.move_to(bad, motion_limits())
    with pytest.raises(ConfigError, match="6 axes"):
        robot.move_to(HOME[:5], motion_limits())
    with pytest.raises(ConfigError, match="positive"):
        robot.move_to(HOME, motion_limits(speed=-1.0))
    assert fake.report()["mb_last"] == 0


def test_by_the_clock(eki_cell):
    fake, robot = eki_cell(controller={"realtime": True})
    began = robot.state().time_s, time.monotonic()
    robot.move_to(FAR, motion_limits(speed=20.0))
    state = arrive(robot)
    np.testing.assert_allclose(state.q, FAR, atol=2e-4)
    assert state.time_s - began[0] <= time.monotonic() - began[1] + 0.1  # the robot's clock does not run ahead
    assert np.nanmax(robot.cycles().columns["sign_of_life_ms"]) < 1000.0
