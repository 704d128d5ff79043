"""The simulated arm: it keeps to its limits, comes to rest when told to, and exists in dry runs only."""

import numpy as np
import pytest
import yaml
from mbcacq_fakes.cell.fake_cell import FakeCell
from mbcacq_fakes.cell.simulated_robot import SimulatedRobot
from mbcacq_fakes.protocols.krc.arm_state import ArmState

from mbcacq.devices import ConfigError, MotionLimits, SafetyStop
from mbcacq.model import shipped
from mbcacq.plan import expand, load

AXES = 7
LIMITS = MotionLimits(np.radians([50.0] * AXES), np.radians([200.0] * AXES), np.radians([2000.0] * AXES), settle_s=0.2)


@pytest.fixture
def arm():
    with ArmState.create((0.0,) * AXES) as state:
        robot = SimulatedRobot("arm", "any", {"limits_deg": [[-100, 100]] * AXES, "state": state, "address": "192.168.0.9"})
        with robot:
            yield robot, state


def settled(robot):
    while not (state := robot.state()).arrived:
        pass
    return state


def test_it_arrives_within_speed_and_acceleration_and_settles(arm):
    robot, state = arm
    target = np.radians([90, -80, 10, 0, 5, -60, 30.0])
    robot.move_to(target, LIMITS)
    assert settled(robot).q == pytest.approx(target)
    rows = robot.cycles().columns
    speed = np.diff(rows["q"], axis=0) / np.diff(rows["time_s"])[:, None]
    assert np.degrees(np.abs(speed).max()) == pytest.approx(50, rel=1e-3)
    assert np.degrees(np.abs(np.diff(speed, axis=0)).max() / 0.004) < 201
    still = np.abs(rows["q"] - target).max(axis=1) < 1e-12
    assert rows["time_s"][still][-1] - rows["time_s"][still][0] >= 0.2 - 1e-9
    assert np.sign(state.read().direction).tolist() == [1, -1, 1, 0, 1, -1, 1]


def test_its_clock_does_not_run_by_looks_at_an_arm_that_rests(arm):
    """A run looks after an arm that waits every so many milliseconds of the computer."""
    robot, _ = arm
    before = {robot.state().time_s for _ in range(10)}
    robot.move_to(np.radians([20.0] * AXES), LIMITS)
    arrived = settled(robot).time_s
    assert len(before) == 1
    assert arrived > max(before)
    assert {robot.state().time_s for _ in range(10)} == {arrived}


def test_stop_brings_it_to_rest_on_the_way(arm):
    robot, state = arm
    robot.move_to(np.radians([90.0] * AXES), LIMITS)
    for _ in range(5):
        robot.state()
    robot.stop()
    where = np.array(state.read().q)
    assert state.read().standstill
    assert (np.degrees(where) < 60).all()
    assert not robot.state().arrived
    assert robot.state().q == pytest.approx(where)


@pytest.mark.parametrize("angle", [101.0, -100.5, np.nan, np.inf])
def test_targets_outside_the_limits_move_nothing(arm, angle):
    robot, _ = arm
    with pytest.raises(SafetyStop, match="A3 would go to"):
        robot.move_to(np.radians([0, 0, angle, 0, 0, 0, 0]), LIMITS)
    assert robot.state().q == pytest.approx(np.zeros(AXES))


def test_a_real_run_cannot_use_it():
    robot = SimulatedRobot("arm", "any", {"limits_deg": [[-100, 100]] * AXES})
    with pytest.raises(ConfigError, match="run the plan with --dry-run, or name your arm's driver"):
        robot.connect()


PLAN = {
    "format": "mbcacq-plan/1",
    "name": "arm",
    "exposures": 1,
    "scanner": {
        "driver": "gocator",
        "options": {"address": "127.0.0.1"},
        "noise_mm": [0.005, 0.005, 0.009],
        "field_of_view": {"near_z_mm": 55, "far_z_mm": -55, "near_half_mm": [35.5, 49], "far_half_mm": [50, 77]},
    },
    "hand_eye": {"rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "translation_mm": [1, -0.5, 265]},
    "artefacts": [str(shipped.folder() / "artefacts" / "mbc-8.yaml")],
    "steps": [
        {
            "name": "views",
            "phase": "orientation",
            "do": "look",
            "stations": ["p1"],
            "views": [{"tilt_deg": 20, "azimuth_deg": a, "roll_deg": r} for a, r in ((0, 0), (120, 30), (240, -30))],
        }
    ],
}
ARMS = {"panda": ([0, -20, 0, -110, 0, 90, 45], [480, 0, 100]), "crx10ia": ([0, 10, 40, 0, -50, 0], [600, 0, 150])}


def plan_for(folder, name):
    home, place = ARMS[name]
    robot = {"driver": "not_installed", "model": str(shipped.robot_file(name)), "options": {"address": "10.0.0.7"}, "home_deg": home}
    stations = [{"id": "p1", "artefact": "mbc", "pose_in_base": {"translation_mm": place}}]
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump({**PLAN, "robot": robot, "stations": stations, "tripod_radius_mm": 0}))
    return path


@pytest.mark.parametrize("name", ARMS)
def test_arms_of_other_makers_run_dry_whatever_their_driver(tmp_path, name):
    import mbcacq

    found = mbcacq.run(plan_for(tmp_path, name), dry_run=True, out=tmp_path / "run")
    loaded = load(plan_for(tmp_path, name))
    with FakeCell(loaded, expand(loaded)) as cell:
        true = np.array(cell.truth()["T_flange_scanner"])
    translation = np.array(found.to_dict()["T_flange_scanner"])[:3, 3]
    assert np.linalg.norm(translation - true[:3, 3]) < 1.0  # the arm's own errors, which one place does not show


def test_fakes_of_a_driver_without_one_point_to_the_dry_run(tmp_path):
    loaded = load(plan_for(tmp_path, "panda"))
    with pytest.raises(ConfigError, match="no fake controller for the driver 'not_installed'.*--dry-run"):
        FakeCell(loaded, expand(loaded), ports="plan").start()
