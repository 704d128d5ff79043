"""A track and a table beside an arm driven over EKI: they move with it, stay within their limits, and stand after each fault."""

import time

import numpy as np
import pytest
from eki_arm import HOME
from eki_bench import DH, EKI_LIMITS_DEG, SPEED_DEG_S
from kuka_bench import arrive, until_error, wait
from mbcacq_kuka.controller_files import eki_files
from mbcacq_kuka.eki.options import EkiOptions

from mbcacq.devices import DeviceFault, DeviceTimeout, IdentityError, MotionLimits, ProtocolError, SafetyStop, parse_options

TABLE = {"name": "E2", "slides": False, "carries_arm": False, "limits": (-180.0, 180.0), "speed": 90.0}
TRACK = {"name": "E1", "slides": True, "carries_arm": True, "limits": (0.0, 3000.0), "speed": 1000.0}
AXES = [TABLE, TRACK]  # as a plan counts them: from the artefact to the arm
START = np.concatenate([[0.0, 1500.0], HOME])


def limits(speed=(20.0, 300.0, *(20.0,) * 6), settle_s=0.05):
    unit = np.where(np.arange(8) == 1, 1.0, np.pi / 180)
    return MotionLimits(*(unit * v * np.array(speed) for v in (1.0, 10.0, 100.0)), np.where(np.arange(8) == 1, 0.1, 2e-4), settle_s)


def stands(fake):
    """The controller says that all axes stand, and a moment later they are where they were, to a micrometre."""
    wait(lambda: fake.state.read().standstill)
    before = np.array(fake.state.read().q)
    time.sleep(0.05)
    return np.abs(np.array(fake.state.read().q) - before).max() < 1e-3


@pytest.fixture
def cell(eki_cell):
    def start(program_limits=None, robot=None, connect=True):
        of_program = [dict(axis, limits=(program_limits or {}).get(axis["name"], axis["limits"])) for axis in AXES]
        given = {"address": "127.0.0.1", "limits_deg": EKI_LIMITS_DEG, "speed_deg_s": SPEED_DEG_S, "external_axes": of_program}
        files = eki_files(parse_options(EkiOptions, "the arm", given), {"plan": "", "robot": "", "speed_share": 1.0})
        controller = {
            "sources": {name.rsplit("/", 1)[1]: text for name, text in files.items() if name.startswith("kss/Program/")},
            "channel": files["kss/EthernetKRL/mbcacq_eki.xml"],
            "external": tuple({**axis, "start": 1500.0 if axis["slides"] else 0.0} for axis in AXES),
        }
        return eki_cell(controller=controller, robot={"external_axes": AXES, **(robot or {})}, connect=connect)

    return start


def test_all_axes_arrive_together_and_are_reported_in_the_plans_order(cell):
    fake, robot = cell()
    target = START + np.array([0.3, -400.0, 0.02, 0, 0, 0, 0, 0.01])
    robot.move_to(target, limits())
    state = arrive(robot)
    near = limits().tolerance  # rad, and mm of the track
    assert np.all(np.abs(state.q - target) <= near)
    assert np.all(np.abs(fake.state.read().q - target) <= 0.1 * near)
    columns = robot.cycles().columns
    np.testing.assert_allclose(columns["q_command"][-1], target, atol=1e-5)
    assert columns["q"].shape[1] == 8


def test_a_slow_track_sets_the_pace(cell):
    """100 mm/s of an axis that makes 1000 are 10 %: over 300 mm the arm turns with the track, not before it."""
    _, robot = cell()
    robot.move_to(START + np.array([0, 300.0, 0.05, 0, 0, 0, 0, 0]), limits(speed=(90.0, 100.0, *(150.0,) * 6)))
    arrive(robot)
    columns = robot.cycles().columns
    speed = np.diff(columns["q"][:, 1]) / np.diff(columns["time_s"])
    assert speed.max() == pytest.approx(100.0, rel=0.05)
    share = (columns["q"] - START)[:, [1, 2]] / [300.0, 0.05]
    assert np.abs(share[:, 0] - share[:, 1]).max() < 0.02


@pytest.mark.parametrize(
    ("axis", "value", "says"), [(1, 3001.0, "E1 would go to 3001"), (0, np.radians(181), "E2 would go to 181"), (1, np.nan, "E1")]
)
def test_a_target_outside_the_limits_is_refused(cell, axis, value, says):
    fake, robot = cell()
    target = START.copy()
    target[axis] = value
    with pytest.raises(SafetyStop, match=says):
        robot.move_to(target, limits())
    assert stands(fake)
    assert np.all(np.abs(np.array(fake.state.read().q) - START) <= limits().tolerance)


def test_the_program_on_the_controller_keeps_limits_of_its_own(cell):
    fake, robot = cell(program_limits={"E1": (1000.0, 1600.0)})
    robot.move_to(START + np.array([0, 200.0, *(0.0,) * 6]), limits())
    error = until_error(robot)
    assert isinstance(error, SafetyStop)
    assert "E1 would leave the limits written into its program; nothing was moved" in str(error)
    assert np.all(np.abs(np.array(fake.state.read().q) - START) <= limits().tolerance)


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ({"silence": 1}, DeviceTimeout),
        ({"close": 1}, DeviceTimeout),
        ({"program_stop": 1}, DeviceFault),
        ({"emergency_stop": 1}, SafetyStop),
    ],
)
def test_a_fault_on_the_way_stops_the_track(cell, fault, kind):
    fake, robot = cell(robot={"silence_s": 2.0} if "silence" in fault else {})
    robot.move_to(START + np.array([0, 1400.0, *(0.0,) * 6]), limits(speed=(20.0, 50.0, *(20.0,) * 6)))
    wait(lambda: robot.state().q[1] > 1502.0)
    fake.inject(**fault)
    assert type(until_error(robot)) is kind
    assert stands(fake)
    assert fake.state.read().q[1] < 2890.0


def test_stop_brakes_the_track(cell):
    fake, robot = cell()
    robot.move_to(START + np.array([0, 1400.0, *(0.0,) * 6]), limits(speed=(20.0, 50.0, *(20.0,) * 6)))
    wait(lambda: robot.state().q[1] > 1502.0)
    robot.stop()
    assert stands(fake)
    assert fake.state.read().q[1] < 2890.0


def test_programs_for_other_axes_are_refused(eki_cell):
    fake, robot = eki_cell(robot={"external_axes": AXES}, connect=False)
    with pytest.raises(ProtocolError, match="Axis/@E1 is None"):
        robot.connect()
    assert fake.report()["mb_last"] == 0


def test_the_flange_is_checked_by_its_orientation_where_a_track_carries_the_arm(cell):
    twisted = tuple((s, t, d, a, x + 1.0 * (k == 1), b) for k, (s, t, d, a, x, b) in enumerate(DH))
    _, robot = cell(robot={"kinematics": twisted}, connect=False)
    with pytest.raises(IdentityError, match="places its flange"):
        robot.connect()
