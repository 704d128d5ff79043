"""UR arms over RTDE: literal bytes of the guide, what stops an arm is named, and a client by others accepts the fake controller."""

import socket
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from dry_runs import plan_file, recorded, ur10
from mbcacq_fakes.protocols.rtde import FakeUrController
from mbcacq_fakes.protocols.rtde.controller import WATCHDOG_S, start_in_cell
from mbcacq_fakes.protocols.stall import STALL_S
from mbcacq_ur import wire
from mbcacq_ur.driver import UrRtdeRobot
from scipy.spatial.transform import Rotation
from uploaded_program import LineArm, ProgrammableUr

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, MotionLimits, ProtocolError, SafetyStop

HOME_DEG = np.array([0.0, -90, 90, -90, -90, 0])
LIMITS = MotionLimits(*(np.radians(np.full(6, v)) for v in (60.0, 200.0, 2000.0)), settle_s=0.05)


@pytest.fixture
def controller():
    with FakeUrController(start_deg=HOME_DEG) as fake:
        yield fake


def arm(controller, **more):
    given = {"address": "127.0.0.1", "port": controller.port, "limits_deg": [[-360, 360]] * 6, "silence_s": 20.0, "connect_timeout_s": 20.0}
    return UrRtdeRobot("arm", "UR10e", {**given, **more})


def watch(robot):
    """Ask for its state until that raises."""
    while True:
        robot.state()
        time.sleep(0.002)


def test_packages_are_the_guide_s_bytes():
    assert wire.packed(wire.VERSION, b"\x00\x02") == bytes.fromhex("00 05 56 00 02")
    assert wire.packed(wire.START) == bytes.fromhex("00 03 53")
    layout = wire.DataLayout(("timestamp", "runtime_state"), b"\x01DOUBLE,UINT32")
    package = bytes.fromhex("00 10 55 01 40 5e dd 2f 1a 9f be 77 00 00 00 02")
    assert layout.write({"timestamp": 123.456, "runtime_state": 2}) == package
    assert layout.read(package[3:]) == {"timestamp": 123.456, "runtime_state": 2}
    buffer = bytearray(bytes.fromhex("00 04 53 01 00 05 56 00"))
    assert list(wire.split(buffer)) == [(83, b"\x01")]
    buffer += b"\x02"
    assert list(wire.split(buffer)) == [(86, b"\x00\x02")]
    with pytest.raises(wire.BadPackage, match="a package of 1 bytes"):
        list(wire.split(bytearray(b"\x00\x01\x53")))


def test_registers_that_another_client_writes_are_named(controller):
    controller.inject(in_use={"input_int_register_0"})
    with pytest.raises(ProtocolError, match=r"lets another client write input_int_register_0 \(IN_USE\); end that client"):
        arm(controller).connect()


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        ({"safety_bits": 1 << 2}, "is protective stopped; look for what it touched"),
        ({"safety_bits": 1 << 6 | 1 << 7}, "is emergency stopped at the robot"),
        ({"safety_bits": 1 << 4}, "is safeguard stopped; close the safeguard"),
        ({"robot_mode": 5}, r"is not running \(idle, brakes closed\)"),
        ({"robot_mode": 3}, r"is not running \(powered off\)"),
        ({"runtime_state": 1}, "runs no program; load mbcacq_ur.script"),
        ({"program": 7}, "runs another program than this driver's"),
        ({"speed_fraction": 0.0}, "has its speed slider at 0 %"),
    ],
)
def test_a_controller_that_is_not_ready_says_why(state, sentence, monkeypatch):
    """The time to become ready is over once it has sent its state."""
    with FakeUrController(start_deg=HOME_DEG, realtime=True, **state) as controller:  # in lock-step it would send thousands of packages
        robot = arm(controller)
        wait = robot._changed.wait_for
        monkeypatch.setattr(robot._changed, "wait_for", lambda _, timeout: wait(lambda: robot._latest is not None, timeout))
        with pytest.raises(ConnectError, match=sentence):
            robot.connect()


@pytest.mark.parametrize(
    ("state", "error", "sentence"),
    [
        ({"safety_bits": 1 << 2}, SafetyStop, "is protective stopped"),
        ({"safety_bits": 1 << 7}, SafetyStop, "is emergency stopped"),
        ({"runtime_state": 1}, DeviceFault, "its program was stopped"),
    ],
)
def test_what_stops_it_on_the_way_is_named_and_the_arm_stands(controller, state, error, sentence):
    with arm(controller) as robot:
        robot.move_to(np.radians(HOME_DEG + 90), LIMITS)
        while not controller.arm.moving:
            time.sleep(0.002)
        controller.inject(**state)
        with pytest.raises(error, match=sentence):
            watch(robot)
        robot.stop()
    assert not controller.arm.moving


def test_speed_slider_payload_and_safety_are_in_its_description(controller):
    controller.inject(speed_fraction=0.5, safety_bits=3)
    with arm(controller, payload_kg=2.3) as robot:
        about = robot.describe()
    assert about.settings == {"speed slider": "50 %", "payload": "2.3 kg", "payload centre": "0.0, 0.0, 32.0 mm", "safety": "reduced"}
    assert about.firmware == "5.15.0.0"
    with pytest.raises(ConfigError, match=r"its payload is set to 2.30 kg, the plan says 4.00 kg"):
        arm(controller, payload_kg=4.0).connect()


def test_a_controller_without_a_variable_names_it(controller):
    controller.inject(not_found={"payload"})
    with pytest.raises(ProtocolError, match=r"does not know payload \(NOT_FOUND\)"):
        arm(controller).connect()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"limits_deg": [[-1, 1]] * 5}, "limits_deg"),
        ({"limits_deg": [[1, -1]] * 6}, "lower limit"),
        ({"address": ""}, "address"),
        ({"adress": "127.0.0.1", "address": None}, "unknown option 'adress' .it knows: address, port"),
        ({"payload_kg": -1.0}, "payload_kg must be a number of at least 0, not -1.0"),
    ],
)
def test_options_that_cannot_be_are_named(controller, options, sentence):
    with pytest.raises(ConfigError, match=sentence):
        arm(controller, **options)


def test_axes_whose_limits_are_in_proportion_to_their_travel_move_as_fast_as_these_allow(controller):
    travel = np.radians([20.0, -10, 5, 0, 0, 1])
    limits = MotionLimits(*(rate * np.maximum(np.abs(travel), 1e-4) for rate in (2.0, 20.0, 2000.0)), settle_s=0.05)
    with arm(controller) as robot:
        robot.move_to(robot.state().q + travel, limits)
        while not robot.state().arrived:
            time.sleep(0.01)
        cycles = robot.cycles().columns
    speed = np.abs(np.gradient(cycles["q"], cycles["time_s"], axis=0))
    assert speed[:, 0].max() == pytest.approx(limits.speed[0], rel=0.02)
    assert (speed <= 1.02 * limits.speed).all()


def test_a_target_beyond_the_limits_moves_nothing(controller):
    with arm(controller, limits_deg=[[-100, 100]] * 6) as robot:
        with pytest.raises(SafetyStop, match=r"A2 would go to -101.000°, outside the joint limits -100..100°; nothing was moved"):
            robot.move_to(np.radians([0, -101, 90, -90, -90, 0]), LIMITS)
        assert np.degrees(robot.state().q) == pytest.approx(HOME_DEG)


RECEIVES = """
import rtde_receive
client = rtde_receive.RTDEReceiveInterface("127.0.0.77")
print(*client.getActualQ(), client.getRobotMode(), int(client.isProtectiveStopped()))
client.disconnect()
"""
SWITCHES = """
import time, rtde_io, rtde_receive
io, client = rtde_io.RTDEIOInterface("127.0.0.77"), rtde_receive.RTDEReceiveInterface("127.0.0.77")
assert io.setStandardDigitalOut(3, True) and io.setSpeedSlider(0.25) and io.setInputIntRegister(20, 7)
while client.getTargetSpeedFraction() != 0.25 or not client.getDigitalOutState(3):
    time.sleep(0.01)
print(*client.getActualTCPPose())
"""
CONTROLS = """
import time, rtde_control, rtde_receive
arm, client = rtde_control.RTDEControlInterface("127.0.0.77"), rtde_receive.RTDEReceiveInterface("127.0.0.77")
def wait(reads, wanted):
    while max(abs(a - b) for a, b in zip(reads(), wanted)) > 1e-6:
        time.sleep(0.01)
q = [0, -1.5, 1.5, -1.5, -1.5, 0.2]
assert arm.moveJ(q, 1.0, 2.0)
wait(client.getActualQ, q)
before = client.getActualTCPPose()
to = [before[0] + 0.1, before[1] + 0.05, before[2] - 0.08, *before[3:]]
assert arm.moveL(to, 0.25, 1.0) and arm.isSteady()
wait(client.getActualTCPPose, to)
wait(arm.getForwardKinematics, to)
wait(lambda: arm.getInverseKinematics(before), q)
assert arm.moveJ([3.0, *q[1:]], 0.5, 1.0, True) and arm.getAsyncOperationProgress() == 0
while client.getActualQ()[0] < 0.2:
    time.sleep(0.01)
arm.stopJ(2.0)
assert arm.isSteady() and arm.getAsyncOperationProgress() < 0
assert arm.setPayload(1.5, [0, 0, 0.03])
print(client.getActualQ()[0])
arm.servoJ(q, 0, 0, 0.002, 0.1, 300)
while arm.isProgramRunning():
    time.sleep(0.01)
print(int(arm.moveJ(q, 1.0, 2.0)))
"""


@pytest.fixture
def said_by():
    """What a program that uses ur_rtde prints. It knows one port only, so the fake stands at a loopback address of its own."""
    if sys.platform != "linux":
        pytest.skip("127.0.0.2 and above are loopback on Linux only")
    pytest.importorskip("rtde_receive")

    def said(program):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stderr
        return [float(number) for number in done.stdout.split()]

    return said


@pytest.mark.parametrize(("bits", "stopped"), [(1, 0), (4, 1)])
def test_a_client_by_others_accepts_the_fake(said_by, bits, stopped):
    with FakeUrController(start_deg=HOME_DEG, host="127.0.0.77", port=30004, safety_bits=bits):
        *q, mode, protective = said_by(RECEIVES)
    assert np.degrees(q) == pytest.approx(HOME_DEG)
    assert (mode, protective) == (7, stopped)


def test_a_client_by_others_switches_outputs_and_the_slider_while_another_one_listens(said_by):
    with FakeUrController(start_deg=HOME_DEG, host="127.0.0.77", port=30004, realtime=True) as fake:
        pose = said_by(SWITCHES)
        assert (fake.outputs, fake.inputs["input_int_register_20"]) == (1 << 3, 7)
    # At home the forearm lies level, and the tool points down: shoulder and upper arm above the base, forearm and flange beside it.
    assert 1e3 * np.array(pose[:3]) == pytest.approx([-571.55 - 119.85, -174.15, 180.7 + 612.7 - 116.55])


def test_a_client_by_others_uploads_its_program_and_moves_the_arm(said_by, caplog):
    with ProgrammableUr("127.0.0.77", HOME_DEG) as fake:
        stopped_at, moved_again = said_by(CONTROLS)
        assert 0.2 < stopped_at < 2.9
        assert not moved_again
        assert fake.values()["payload"] == 1.5
        assert not fake.arm.moving
    assert "the fake does nothing for command 11 (servo, speed and force are not played)" in caplog.text


def test_a_line_is_straight_and_driven_at_its_speed():
    arm = LineArm(HOME_DEG)
    begin = np.array(arm.flange_pose(arm.q))
    end = begin + [0.1, 0.05, -0.08, 0, 0, 0]
    arm.go_along(*arm.line(end), 0.25, 1.0)
    places = []
    while arm.moving:
        arm.advance(0.002)
        places.append(arm.flange_pose(arm.q)[:3])
    way = (end - begin)[:3] / np.linalg.norm((end - begin)[:3])
    along = (places - begin[:3]) @ way
    assert np.abs(places - begin[:3] - along[:, None] * way).max() < 1e-5
    assert np.diff(along).max() / 0.002 == pytest.approx(0.25, rel=1e-3)
    np.testing.assert_allclose(places[-1], end[:3], atol=1e-6)


@pytest.fixture
def conversation(controller):
    """Sends a package as bytes in hexadecimal, and gives the answer as bytes."""
    with socket.create_connection(("127.0.0.1", controller.port)) as link:
        link.settimeout(20.0)

        def ask(sent):
            link.sendall(sent)
            head = link.recv(3, socket.MSG_WAITALL)
            return head + link.recv(struct.unpack(">H", head[:2])[0] - 3, socket.MSG_WAITALL)

        yield ask


def test_documented_variables_have_the_guide_s_types(conversation):
    names = b"external_force_torque,output_bit_register_64,input_bit_registers32_to_63,encoder0_raw,tool_output_mode,payload_cog,dexterity"
    answer = conversation(struct.pack(">HBd", 11 + len(names), ord("O"), 125.0) + names)
    assert answer[2:] == b"O\x01VECTOR6D,BOOL,UINT32,INT32,UINT8,VECTOR3D,DOUBLE"


def test_a_refused_recipe_ends_no_conversation(controller, conversation):
    controller.inject(in_use={"input_int_register_0"})
    names = b"input_int_register_0,input_int_register_99"
    assert conversation(struct.pack(">HB", 3 + len(names), ord("I")) + names)[2:] == b"I\x00IN_USE,NOT_FOUND"
    assert conversation(bytes.fromhex("00 05 56 00 02")) == bytes.fromhex("00 04 56 01")


def test_tcp_pose_at_zero_is_the_published_one_of_a_ur10e():
    """All joints at zero: the arm is stretched along -x, the flange looks along -y."""
    with FakeUrController(start_deg=[0.0] * 6) as fake:
        pose = fake.tcp_pose()
    assert 1e3 * np.array(pose[:3]) == pytest.approx([-612.7 - 571.55, -174.15 - 116.55, 180.7 - 119.85])
    assert pose[3:] == pytest.approx([np.pi / 2, 0, 0])


def test_tcp_speed_is_the_derivative_of_the_pose():
    with FakeUrController(start_deg=HOME_DEG) as fake:
        fake.arm.qd = np.array([0.1, -0.2, 0.3, 0.05, 0.2, -0.4])
        before, speed = fake.tcp_pose(), fake.tcp_speed()
        fake.arm.q = fake.arm.q + 1e-4 * fake.arm.qd
        after = fake.tcp_pose()
    assert speed[:3] == pytest.approx((np.array(after[:3]) - before[:3]) / 1e-4, abs=1e-4)
    turned = Rotation.from_rotvec(after[3:]) * Rotation.from_rotvec(before[3:]).inv()
    assert speed[3:] == pytest.approx(turned.as_rotvec() / 1e-4, abs=1e-4)


def test_the_slider_acts_on_the_move_under_way():
    with FakeUrController(start_deg=HOME_DEG) as fake:
        target = np.radians(HOME_DEG + 30)
        registers = dict(zip((f"input_double_register_{k}" for k in range(8)), [*target, 0.5, 2.0], strict=True))
        fake.obey({**registers, "input_int_register_0": 1, "input_int_register_1": 1})
        for _ in range(100):
            fake.advance(0.002)
        full = np.abs(fake.arm.qd).max()
        fake.inject(speed_fraction=0.0)
        for _ in range(200):
            fake.advance(0.002)
        stands = fake.arm.q
        fake.advance(1.0)
        assert full > 0.1
        assert np.abs(fake.arm.qd).max() == 0
        np.testing.assert_array_equal(fake.arm.q, stands)
        assert fake.arm.moving
        fake.inject(speed_fraction=1.0)
        for _ in range(2000):
            fake.advance(0.002)
        assert np.degrees(fake.arm.q) == pytest.approx(HOME_DEG + 30)


def test_the_controller_s_program_carries_version_and_payload():
    facts = {"plan": "a plan", "load_kg": 2.3, "load_centre_mm": (0.0, 0.0, 32.0)}
    files = UrRtdeRobot.controller_files("ur_rtde", "UR10e", {}, facts)
    script = files["mbcacq_ur.script"]
    assert "write_output_integer_register(2, 20261)" in script
    assert "set_payload(2.300, [0.0000, 0.0000, 0.0320])" in script
    assert "@" not in script


def test_a_dry_run_drives_it_over_rtde(tmp_path):
    change = ur10("ur_rtde", {"address": "192.168.0.10", "payload_kg": 1.5})
    assert recorded(plan_file(tmp_path, change), tmp_path / "run").n_poses == 4


def held_once(robot, seconds):
    """The thread that answers the controller is held for a time, once, as on a computer that stands still."""
    take, left = robot._take, [seconds]

    def slowly(values):
        time.sleep(left.pop() if left and values["output_int_register_1"] else 0.0)
        return take(values)

    robot._take = slowly


def test_a_stall_of_the_computer_ends_no_dry_run():
    """In lock-step the robot's clock stands with the computer: longer than the watchdog of a real controller, and than a usual stall."""
    fake, options = start_in_cell(None, start_deg=HOME_DEG, realtime=False, ports="free", plan_options={})
    try:
        robot = arm(fake, **options)
        held_once(robot, STALL_S + 0.5)
        with robot:
            target = np.radians(HOME_DEG + [20, 0, 0, 0, 0, 0])
            robot.move_to(target, LIMITS)
            while not robot.state().arrived:
                time.sleep(0.002)
            assert np.abs(robot.state().q - target).max() < 1e-6
    finally:
        fake.stop()


def test_a_silent_client_stops_the_arm_by_its_watchdog():
    with FakeUrController(start_deg=HOME_DEG, realtime=True) as fake:
        robot = arm(fake)
        held_once(robot, 4 * WATCHDOG_S)
        with robot:
            robot.move_to(np.radians(HOME_DEG + [170, 0, 0, 0, 0, 0]), LIMITS)
            with pytest.raises(DeviceFault, match=r"ended away from its target; for \d\.\d\d s this computer answered no package"):
                watch(robot)
            assert not fake.arm.moving
            assert np.degrees(fake.arm.q[0]) < 165
