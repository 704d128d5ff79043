"""What reaches the controller: smooth, within the limits, ending where it was asked to; seen at the controller's side."""

import numpy as np
import pytest
from kuka_bench import HOME_DEG, arrive, motion_limits, wait

from mbcacq.devices import Robot, SafetyStop

CYCLE_S = 0.004
ROUNDING = 1e-6  # decimals of the answer, deg


def corrections(krc):
    """(k, 6) accepted corrections, deg, one a cycle, and their IPOC."""
    log = krc.log()
    return log["correction"][log["accepted"]], log["ipoc"][log["accepted"]]


def within_limits(path, speed, acceleration, jerk):
    bounds = ((1, speed, 2), (2, acceleration, 4), (3, jerk, 8))
    return all(
        np.abs(np.diff(path, order, axis=0)).max() / CYCLE_S**order <= limit * 1.001 + noise * ROUNDING / CYCLE_S**order
        for order, limit, noise in bounds
    )


@pytest.mark.parametrize("realtime", [False, True])
def test_a_motion_obeys_its_limits_and_arrives(cell, realtime):
    by_the_clock = {"realtime": realtime, "stretch": 4.0, "timeout": 10**6}  # slowly, as the machine may be busy
    krc, robot = cell({"log": True, **by_the_clock}, {"late_limit": 10**6})
    assert isinstance(robot, Robot)
    target = np.radians(HOME_DEG + [25.0, 12.0, -20.0, 40.0, -35.0, 60.0])
    robot.move_to(target, motion_limits(90.0, 360.0, 3600.0))
    state = arrive(robot)
    np.testing.assert_allclose(state.q, target, atol=2e-4)
    path, ipoc = corrections(krc)
    undisturbed = krc.report()["late"] == 0  # by the clock, a busy computer may lose a cycle; then the arm waits and goes on
    assert undisturbed or realtime
    assert np.abs(np.diff(path, axis=0)).max() <= 90.0 * CYCLE_S * 1.001 + 2 * ROUNDING
    assert np.abs(np.diff(path, axis=0)).max() / CYCLE_S > 85.0  # the fastest axis does use its speed
    np.testing.assert_allclose(path[-1], [25.0, 12.0, -20.0, 40.0, -35.0, 60.0], atol=1e-6)
    if undisturbed:
        assert within_limits(path, 90.0, 360.0, 3600.0)
        assert set(np.diff(ipoc)) == {4}


def test_the_path_is_straight_in_joint_space(cell):
    krc, robot = cell({"log": True})
    robot.move_to(np.radians(HOME_DEG + [30.0, 15.0, -7.5, 0.0, 3.0, 1.0]), motion_limits())
    arrive(robot)
    path, _ = corrections(krc)
    path = path[np.flatnonzero(path[:, 0])[0] :]  # before, the last axis was probed
    np.testing.assert_allclose(path, path[:, :1] / 30.0 * [30.0, 15.0, -7.5, 0.0, 3.0, 1.0], atol=2e-6)


def test_stop_brakes_within_the_limits_and_a_new_motion_may_follow(cell):
    krc, robot = cell({"log": True})
    robot.move_to(np.radians(HOME_DEG + [80.0, 0.0, 0.0, 0.0, 0.0, 0.0]), motion_limits(speed=20.0))
    wait(lambda: np.degrees(robot.state().q[0]) > 5.0)
    robot.stop()
    robot.stop()
    wait(lambda: not robot.state().moving)
    state = robot.state()
    assert not state.arrived
    assert 5.0 < np.degrees(state.q[0]) < 79.0
    wait(lambda: krc.state.read().standstill)
    robot.move_to(np.radians(HOME_DEG), motion_limits())
    arrive(robot)
    path, _ = corrections(krc)
    assert within_limits(path, 90.0, 360.0, 3600.0)


def test_a_new_target_while_moving_is_taken_smoothly(cell):
    krc, robot = cell({"log": True})
    robot.move_to(np.radians(HOME_DEG + [50.0, 0.0, 20.0, 0.0, 0.0, 0.0]), motion_limits(speed=20.0))
    wait(lambda: np.degrees(robot.state().q[0]) > 5.0)
    target = np.radians(HOME_DEG + [-20.0, 5.0, 0.0, 0.0, 30.0, 0.0])
    robot.move_to(target, motion_limits())
    np.testing.assert_allclose(arrive(robot).q, target, atol=2e-4)
    assert within_limits(corrections(krc)[0], 90.0, 360.0, 3600.0)


def test_arrival_waits_for_the_settling_time_of_the_robots_clock(cell):
    krc, robot = cell()
    robot.cycles()
    target = np.radians(HOME_DEG + [5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    robot.move_to(target, motion_limits(settle_s=0.5))
    state = arrive(robot)
    cycles = robot.cycles()
    inside = np.abs(cycles.columns["q"] - target).max(axis=1) <= 2e-4
    first = cycles.columns["time_s"][np.argmax(inside)]
    assert inside[np.argmax(inside) :].all()
    assert state.time_s - first >= 0.5 - 1e-9


def test_every_cycle_is_delivered_once(cell):
    krc, robot = cell()
    parts = []
    for i in range(4):
        robot.move_to(np.radians(HOME_DEG + [10.0 * (i % 2), 0.0, 0.0, 0.0, 0.0, 0.0]), motion_limits())
        arrive(robot)
        parts.append(robot.cycles())
    robot.close()
    parts.append(robot.cycles())
    ipoc = np.concatenate([p.columns["ipoc"] for p in parts])
    assert set(np.diff(ipoc)) == {4.0}
    cycles = parts[0].columns
    assert {"time_s", "host_time_s", "q", "q_set", "q_command", "current_percent", "delay", "ipoc", "RIst", "answered"} <= set(cycles)
    assert cycles["q"].shape == cycles["q_command"].shape == cycles["current_percent"].shape == (len(parts[0]), 6)
    np.testing.assert_allclose(np.degrees(cycles["q_set"]), np.tile(HOME_DEG, (len(parts[0]), 1)), atol=1e-6)  # ASPos holds no correction
    np.testing.assert_allclose(cycles["time_s"], cycles["ipoc"] / 1000.0)
    assert len(robot.cycles()) == 0


def test_targets_outside_the_joint_limits_never_move_anything(cell):
    krc, robot = cell({"log": True})
    for axis, angle in [(0, 185.1), (1, 11.0), (4, -126.0), (2, np.nan), (5, np.inf)]:
        target = HOME_DEG.copy()
        target[axis] = angle
        with pytest.raises(SafetyStop, match=f"A{axis + 1} would go to .* nothing was moved"):
            robot.move_to(np.radians(target), motion_limits())
    before = krc.report()["answers"]
    wait(lambda: krc.report()["answers"] > before + 30)
    sent = corrections(krc)[0]
    assert not sent[:, :5].any()
    assert np.abs(sent).max() <= 0.004  # the probe of the last axis
    assert not sent[-10:].any()


def test_targets_outside_the_correction_limits_never_move_anything(cell):
    krc, robot = cell({"clamp_deg": 5.0}, {"correction_limit_deg": 5.0})
    with pytest.raises(SafetyStop, match="A3 .* outside the limits of its RSI correction 85..95"):
        robot.move_to(np.radians(HOME_DEG + [0, 0, 5.2, 0, 0, 0]), motion_limits())
    robot.move_to(np.radians(HOME_DEG + [0, 0, 4.9, 0, 0, 0]), motion_limits())
    arrive(robot)


def test_the_model_speed_is_never_exceeded(cell):
    krc, robot = cell({"log": True}, {"speed_deg_s": [50.0] * 6})
    robot.move_to(np.radians(HOME_DEG + [40.0, 0, 0, 0, 0, 0]), motion_limits(speed=300.0, acceleration=900.0, jerk=9000.0))
    arrive(robot)
    assert within_limits(corrections(krc)[0], 50.0, 900.0, 9000.0)


def test_closing_while_moving_brakes_and_ends_the_session(cell):
    krc, robot = cell({"log": True})
    robot.move_to(np.radians(HOME_DEG + [80.0, 0, 0, 0, 0, 0]), motion_limits(speed=20.0))
    wait(lambda: np.degrees(robot.state().q[0]) > 5.0)
    robot.close()
    robot.close()
    wait(lambda: krc.report()["sessions"] >= 2)  # the program ended by Stop, and was started again
    assert krc.state.read().standstill
    path, _ = corrections(krc)
    moving = path[: np.flatnonzero(np.diff(path[:, 0]) > 0)[-1] + 2]
    assert within_limits(moving, 20.0, 360.0, 3600.0)
    robot.connect()
    robot.move_to(np.radians(HOME_DEG), motion_limits())
    arrive(robot)


def test_the_slower_cycle_of_ipo(cell):
    krc, robot = cell({"log": True, "cycle_ms": 12}, {"cycle_ms": 12})
    target = np.radians(HOME_DEG + [15.0, 3.0, 0.0, -20.0, 0.0, 0.0])
    robot.move_to(target, motion_limits())
    np.testing.assert_allclose(arrive(robot).q, target, atol=2e-4)
    path, ipoc = corrections(krc)
    assert set(np.diff(ipoc)) == {12}
    assert np.abs(np.diff(path, axis=0)).max() <= 90.0 * 0.012 * 1.001 + 2e-6
    np.testing.assert_allclose(np.diff(robot.cycles().columns["time_s"]), 0.012, atol=1e-9)
