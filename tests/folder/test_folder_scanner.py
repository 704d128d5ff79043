"""``driver: folder``: an old or half-written cloud is never taken, and what does not come is named."""

import os
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.folder import FakeScannerProgram
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_folder.driver import FolderScanner

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout, ProtocolError
from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq.spheres.cloud_files import read_points

POINTS = np.arange(30, dtype=np.float32).reshape(2, 5, 3)


@pytest.fixture
def program(tmp_path):
    number = iter(range(100))
    with FakeScannerProgram(lambda exposure_us: ScannerFrame(POINTS + np.float32(100 * next(number))), tmp_path) as program:
        yield program


def scanner(tmp_path, program=None, **more):
    trigger = {"tcp": f"127.0.0.1:{program.port}", "reply": "OK"} if program else {"person": True}
    given = {"folder": tmp_path, "pattern": "*.ply", "trigger": trigger, "quiet_s": 0.05, "timeout_s": 60.0, "read_cloud": read_points}
    return FolderScanner("s", "", {**given, **more})


def test_each_trigger_gives_its_own_cloud(tmp_path, program):
    write_ply(tmp_path / "zz-old.ply", np.full((4, 3), 7, np.float32))
    with scanner(tmp_path, program) as device:
        first, second = device.capture(), device.capture()
    assert first.points == pytest.approx(POINTS.reshape(-1, 3))
    assert second.points == pytest.approx(POINTS.reshape(-1, 3) + 100)
    assert (first.frame, second.frame, first.warnings) == (1, 2, ())


@pytest.mark.parametrize("way", ["serial", "command", "person"])
def test_other_ways_to_trigger(tmp_path, program, way, monkeypatch):
    asked = []

    def person(text, **_):
        asked.append(text)
        program._save()

    monkeypatch.setattr("mbcacq_folder.trigger.print", person, raising=False)
    write_ply(tmp_path / "source.writing", POINTS.reshape(-1, 3))
    copied = f"import shutil; shutil.copy({str(tmp_path / 'source.writing')!r}, {str(tmp_path / 'new.ply')!r})"
    trigger = {
        "serial": {"serial": f"socket://127.0.0.1:{program.port}", "send": "trigger\n", "reply": "OK"},
        "command": {"command": [sys.executable, "-S", "-c", copied]},
        "person": {"person": True},
    }[way]
    with scanner(tmp_path, trigger=trigger) as device:
        assert len(device.capture().points) == 10
    assert asked == ["scanner 's': take one cloud now"] * (way == "person")


def test_a_cloud_is_taken_once_it_is_written_whole(tmp_path, program):
    program.faults.set("slowly", 0.4)
    with scanner(tmp_path, program, quiet_s=0.0) as device:
        assert len(device.capture().points) == 10


@pytest.mark.parametrize(
    ("fault", "error", "sentence"),
    [
        ("silent", DeviceTimeout, "did not acknowledge the trigger in time"),
        ("refused", ProtocolError, "answered 'BUSY' to the trigger"),
        ("no_cloud", DeviceTimeout, r"no new cloud \(\*.ply\) in .* 2 s after the trigger"),
        ("another_name", DeviceTimeout, "so named"),
        ("half", DeviceFault, "cloud_0001.ply: is (cut off|no PLY file)"),
        ("empty", DeviceTimeout, "cloud_0001.ply is still being written"),
    ],
)
def test_what_does_not_come_is_named(tmp_path, program, fault, error, sentence):
    write_ply(tmp_path / "old.ply", np.ones((4, 3), np.float32))
    program.faults.set(fault)
    with scanner(tmp_path, program, timeout_s=60.0 if error is ProtocolError else 2.0) as device, pytest.raises(error, match=sentence):
        device.capture()


def test_two_clouds_for_one_trigger_are_said(tmp_path, program):
    program.faults.set("twice")
    with scanner(tmp_path, program, quiet_s=0.3) as device:
        found = device.capture()
    assert "2 new clouds stand in the folder after one trigger (cloud_0002.ply); cloud_0001.ply was taken" in found.warnings[0]


def test_a_cloud_written_over_the_old_one_is_new(tmp_path):
    """Some programs always save under the same name."""
    path = tmp_path / "scan.ply"
    write_ply(path, np.ones((4, 3), np.float32))
    os.utime(path, (1.0, 1.0))
    code = f"import shutil; shutil.copy({str(tmp_path / 'next.bin')!r}, {str(path)!r})"
    write_ply(tmp_path / "next.bin", np.full((4, 3), 2, np.float32))
    with scanner(tmp_path, trigger={"command": [sys.executable, "-c", code]}) as device:
        assert device.capture().points == pytest.approx(np.full((4, 3), 2))


def test_a_command_that_fails_says_what_it_said(tmp_path):
    code = "import sys; sys.exit('the projector is off')"
    with scanner(tmp_path, trigger={"command": [sys.executable, "-c", code]}) as device:
        with pytest.raises(DeviceFault, match=r"ended with 1 \(the projector is off\)"):
            device.capture()
    with scanner(tmp_path, trigger={"command": ["/no/such/program"]}) as device, pytest.raises(ConnectError, match="cannot be started"):
        device.capture()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"trigger": {}}, "give one of person, command, tcp, serial and output, not none"),
        ({"trigger": {"tcp": "a:1", "person": True}}, "not person and tcp"),
        ({"trigger": {"tcp": "nowhere"}}, "trigger.tcp"),
        ({"trigger": {"tcp": "a:1", "reply": "("}}, "trigger.reply is no pattern"),
        ({"timeout_s": 0}, "timeout_s"),
    ],
)
def test_options_that_cannot_be_are_named(tmp_path, options, sentence):
    with pytest.raises(ConfigError, match=sentence):
        scanner(tmp_path, **options)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConnectError, match="there is no folder"):
        scanner(tmp_path / "clouds").connect()


@contextmanager
def arm_with_outputs(kind):
    """A robot in front of its fake controller, which may switch output 3; and how often that was switched on."""
    if kind == "ur":
        from mbcacq_fakes.protocols.rtde import FakeUrController
        from mbcacq_ur.driver import UrRtdeRobot

        with ArmState.create() as state, FakeUrController(state) as controller:
            options = {"address": "127.0.0.1", "port": controller.port, "limits_deg": [[-360, 360]] * 6, "silence_s": 20.0}
            with UrRtdeRobot("arm", "UR10e", {**options, "digital_outputs": [3]}) as robot:
                yield robot, state
        return
    from mbcacq_fakes.protocols.krc.server import FakeKrc
    from mbcacq_kuka.rsi.driver import KukaRsi

    port = free_port()
    with FakeKrc(client=("127.0.0.1", port), realtime=False, digital_outputs=(3,)) as controller:
        options = {"limits_deg": [[-185, 185], [-140, 10], [-120, 168], [-350, 350], [-125, 125], [-350, 350]], "port": port}
        with KukaRsi("arm", "", {**options, "silence_s": 20.0, "digital_outputs": [3]}) as robot:
            yield robot, controller.state


@pytest.mark.parametrize("kind", ["ur", "rsi"])
def test_an_output_of_the_robot_triggers_it(tmp_path, kind):
    """At the wire: the controller's output 3 is the scanner program's trigger; others are not, and it is off again afterwards."""
    from mbcacq.acquisition.cell_devices import hand_on_outputs

    device = scanner(tmp_path, trigger={"output": 3, "pulse_s": 0.01})
    source = lambda exposure_us: ScannerFrame(POINTS)  # noqa: E731
    with arm_with_outputs(kind) as (robot, state), FakeScannerProgram(source, tmp_path, rises=lambda: state.output(3)[1]):
        hand_on_outputs(robot, device)
        with device:
            assert len(device.capture().points) == 10
        with pytest.raises(ConfigError, match="output 4 may not be switched from here; add it to the option digital_outputs"):
            robot.set_output(4, True)
        assert state.output(3) == (False, 1)
        with pytest.raises(
            ConfigError, match=r"trigger.output is 4, which the robot may not switch; add digital_outputs: \[4\] to the robot"
        ):
            hand_on_outputs(robot, scanner(tmp_path, trigger={"output": 4}))


def test_a_robot_without_outputs_is_refused_before_anything_is_opened(tmp_path):
    from mbcacq.acquisition.cell_devices import hand_on_outputs

    with pytest.raises(ConfigError, match="which this one does not; trigger it by tcp, serial, command or person"):
        hand_on_outputs(object(), scanner(tmp_path, trigger={"output": 0}))


@pytest.mark.parametrize("more", [{"digital_outputs": [8]}, {"digital_outputs": [1], "follow": True}])
def test_outputs_that_cannot_be_switched_are_named(more):
    from mbcacq_ur.driver import UrRtdeRobot

    with pytest.raises(ConfigError, match="digital_outputs"):
        UrRtdeRobot("arm", "", {"address": "127.0.0.1", "limits_deg": [[-1, 1]] * 6, **more})
