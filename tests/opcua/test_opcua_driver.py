"""Joint angles by OPC UA: against asyncua's own server with the companion nodes for robots. Nothing is ever written."""

import asyncio
import time
from contextlib import contextmanager

import numpy as np
import pytest
from asyncua.client.client import Client
from asyncua.client.ua_client import UaClient
from mbcacq_fakes.protocols.opcua import FakeOpcUaServer
from mbcacq_fakes.protocols.opcua.address_space import ArmNodes, unit
from mbcacq_opcua.driver import OpcUaRobot

from mbcacq.conformance import Channel, TcpProxy
from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout, IdentityError, MotionLimits, ProtocolError, SafetyStop

HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
LIMITS = MotionLimits(*(np.full(6, v) for v in (1.0, 3.0, 30.0)))
ON_A_TRACK = ArmNodes(  # ten axes, so that their names do not sort as texts; the track is linear; angles in rad
    model="M-10iD",
    names=("Axis_1", "Axis_2", "Axis_3", "Axis_9", "Axis_10", "Axis_11", "Track"),
    profiles=(1, 1, 1, 1, 1, 1, 3),
    unit="rad",
    payload_kg=None,
)


@pytest.fixture(scope="module")
def controller():
    with FakeOpcUaServer(start_deg=HOME_DEG) as fake:
        yield fake


@pytest.fixture(scope="module")
def on_a_track():
    with FakeOpcUaServer(start_deg=HOME_DEG, arm=ON_A_TRACK) as fake:
        yield fake


def arm(fake, n=6, **more):
    given = {"address": "127.0.0.1", "port": fake.port, "limits_deg": [[-360, 360]] * n, "rate_hz": 100.0}
    return OpcUaRobot("arm", "KR 10", {**given, **more})


@contextmanager
def fault(fake, **faults):
    fake.inject(**faults)
    try:
        yield
    finally:
        fake.inject(**dict.fromkeys(faults, 0))


def until_error(robot):
    while True:
        robot.state()
        time.sleep(0.005)


def test_units_are_numbers_made_of_their_codes():
    assert (unit("deg").UnitId, unit("rad").UnitId, unit("kg").UnitId) == (17476, 4405297, 4933453)  # UNECE rec. 20: DD, C81, KGM


def test_it_reads_axes_loads_and_who_is_there(controller):
    with arm(controller, payload_kg=2.3) as robot:
        assert np.allclose(np.degrees(robot.state().q), np.degrees(controller.q))
        about = robot.describe()
    assert (about.serial, about.firmware) == ("4711", "8.6.11")
    assert about.settings["payload"] == "2.3 kg"
    assert about.settings["OperationalMode"] == "1"


def test_angles_in_rad_of_the_rotary_axes_in_their_order(on_a_track):
    with arm(on_a_track) as robot:
        assert np.allclose(np.degrees(robot.state().q), HOME_DEG)
        assert robot.describe().settings["axes"] == "Axis_1, Axis_2, Axis_3, Axis_9, Axis_10, Axis_11"
    with arm(on_a_track, axes=["Axis_2", "Axis_1"], n=2) as robot:
        assert np.allclose(np.degrees(robot.state().q), [-90, 0])


def test_a_controller_that_counts_otherwise_is_converted(controller):
    couple = np.eye(6)
    couple[2, 1] = -1.0  # J3 from the horizontal, J3 = q3 - q2
    offset = [0, 0, 90, 0, 0, 0]
    with arm(controller, controller_matrix=couple.tolist(), controller_offset_deg=offset) as robot:
        q = np.degrees(robot.state().q)
    assert np.allclose(couple @ q + offset, np.degrees(controller.q))


@pytest.mark.parametrize(
    ("more", "error", "sentence"),
    [
        ({"n": 7}, ConfigError, "has no motion device with 7 rotary axes (it has MotionDevice_1: Axis_1, Axis_2"),
        ({"arm": "R2"}, ConfigError, "has no motion device 'R2' (it has: MotionDevice_1)"),
        ({"expect_model": "M-10iD"}, IdentityError, "is a 'KR 10 R1100-2', not a 'M-10iD'"),
        ({"payload_kg": 5.0}, ConfigError, "has a flange load of 2.30 kg, the plan says 5.00 kg"),
        ({"user": "operator", "password_env": "MBCACQ_NO_SUCH"}, ConfigError, "the environment variable MBCACQ_NO_SUCH is not set"),
    ],
)
def test_another_robot_than_the_plan_s_is_named(controller, more, error, sentence):
    with pytest.raises(error) as caught:
        arm(controller, **more).connect()
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"axes": ["A1"]}, "axes names 1 axes of an arm that has 6"),
        ({"password_env": "X"}, "password_env needs a user"),
        ({"password": "x"}, "unknown option 'password'"),  # it would stand in every recording
    ],
)
def test_options_that_cannot_be_are_named(options, sentence):
    with pytest.raises(ConfigError) as caught:
        OpcUaRobot("arm", "", {"address": "127.0.0.1", "limits_deg": [[-1, 1]] * 6, **options})
    assert sentence in str(caught.value)


def test_an_angle_that_is_bad_or_none_ends_it(controller):
    with fault(controller, bad=3), pytest.raises(DeviceFault) as caught:
        arm(controller).connect()
    assert "marks the angle of 'Axis_3' as BadSensorFailure" in str(caught.value)
    with arm(controller) as robot, fault(controller, not_a_number=2), pytest.raises(ProtocolError) as caught:
        until_error(robot)
    assert "joint angles that cannot be" in str(caught.value)


def test_a_channel_that_lives_shorter_than_the_run_is_renewed(controller, monkeypatch):
    """The hour that a channel is granted is a tenth of a second here."""
    renewed, open_channel = [], Client.open_secure_channel

    async def shorter(self, renew=False):
        self.secure_channel_timeout = 100
        await open_channel(self, renew)
        renewed.append(renew)

    monkeypatch.setattr(Client, "open_secure_channel", shorter)
    with arm(controller, silence_s=60.0) as robot:
        while renewed.count(True) < 5:
            robot.state()
            time.sleep(0.005)
        before = robot.state().time_s
        while robot.state().time_s == before:
            time.sleep(0.005)
    assert renewed.count(False) == 1


def test_a_server_that_was_started_again_is_not_read_on(controller, on_a_track):
    """Its clock counts from another start."""
    with TcpProxy(Channel("opcua"), ("127.0.0.1", controller.port)) as proxy:
        robot = arm(controller, port=proxy.port, angle_unit="deg", silence_s=60.0)
        with robot:
            proxy._device = ("127.0.0.1", on_a_track.port)
            proxy.cut()
            with pytest.raises(DeviceFault, match="the server was started again, and its clock with it"):
                until_error(robot)


def test_an_answer_that_comes_while_its_request_is_given_up_is_a_lost_server(controller, monkeypatch):
    """asyncua ends such a request by a kind of cancellation of its own."""

    class AnsweredMeanwhile(asyncio.CancelledError):
        pass

    async def too_late(*_):
        try:
            await asyncio.sleep(600.0)
        except asyncio.CancelledError as error:
            raise AnsweredMeanwhile from error

    with arm(controller, silence_s=0.1) as robot:
        monkeypatch.setattr(UaClient, "read_attributes", too_late)
        with pytest.raises(DeviceTimeout, match="was lost"):
            until_error(robot)


def test_nothing_is_written_and_nothing_called(controller, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("it writes")

    for service in ("write", "write_attributes", "call", "add_nodes", "delete_nodes", "create_subscription"):
        monkeypatch.setattr(UaClient, service, refuse)
    with arm(controller) as robot:
        with pytest.raises(SafetyStop, match="nothing was moved"):
            robot.move_to(np.zeros(6), LIMITS)
        robot.stop()
        assert robot.state().q.shape == (6,)
        time.sleep(0.05)
        assert len(robot.cycles()) > 0


def test_nobody_there_is_named():
    with FakePort() as port, pytest.raises(ConnectError) as caught:
        OpcUaRobot("arm", "", {"address": "127.0.0.1", "port": port, "limits_deg": [[-1, 1]] * 6, "connect_timeout_s": 1.0}).connect()
    assert "is its OPC UA server on" in str(caught.value)


class FakePort:
    """A port that nobody listens at."""

    def __enter__(self):
        from mbcacq_fakes.cell.ports import free_port

        return free_port()

    def __exit__(self, *_):
        return None


def test_a_unit_that_is_stated_but_not_known_is_named_and_the_plan_s_counts():
    with FakeOpcUaServer(start_deg=HOME_DEG, arm=ArmNodes(unit="gon")) as fake:
        with pytest.raises(ConfigError, match="states 'gon' as unit of axis 'Axis_1', which is not known here"):
            arm(fake).connect()
        with arm(fake, angle_unit="deg") as robot:
            assert np.degrees(robot.state().q) == pytest.approx(HOME_DEG)
