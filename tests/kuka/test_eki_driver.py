"""The driver in front of the programs of the controller: the wrong cell and wrong options are refused, spoilt telegrams too."""

import threading

import numpy as np
import pytest
from eki_arm import FAR, HOME
from eki_bench import DH, EKI_LIMITS_DEG, SPEED_DEG_S
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from kuka_bench import arrive, motion_limits
from mbcacq_fakes.cell.ports import free_port
from mbcacq_kuka.eki import telegrams
from mbcacq_kuka.eki.driver import KukaEki
from mbcacq_kuka.eki.framing import Cutter

from mbcacq.devices import ConfigError, ConnectError, IdentityError


@pytest.mark.parametrize(
    ("controller", "robot", "says"),
    [
        ({"model": "#KR6R900_2 C4"}, {}, r"drives a '#KR6R900_2 C4', the plan is for 'KR 10 R1100-2'"),
        ({}, {"tool": 2}, "works with tool 1, the plan expects tool 2"),
        ({}, {"base": 3}, "works with base 0, the plan expects base 3"),
        ({"tools": {"1": (0, 0, 264.8, 0, 0, 0)}}, {"tool_frame": [0, 0, 265.8, 0, 0, 0]}, "1.00 mm and 0.00° between its tool data"),
        ({"loads": {"1": 10.0}}, {"load_kg": 2.3}, "a load of 10 kg, the plan says 2.3 kg"),
        ({"mode": "#EX"}, {"mode": "T1"}, "is in mode EXT, the plan expects T1"),
        ({"override": 30}, {}, "an override of 30 %, the plan expects 100 %"),
        ({"dh": tuple((s, t, d + 5.0 * (k == 3), a, x, b) for k, (s, t, d, a, x, b) in enumerate(DH))}, {}, "its flange 5.0 mm from where"),
        ({"robroot": (0, 0, 0, 0, 90.0, 0)}, {"flange_tolerance_mm": 1.0}, None),
        ({}, {"limits_deg": [(2, 5), *EKI_LIMITS_DEG[1:]]}, "shows A1 at 0.00°, outside the plan's limits 2..5"),
    ],
)
def test_another_cell_than_the_plans_is_refused(eki_cell, controller, robot, says):
    fake, driver = eki_cell(controller=controller, robot=robot, connect=False)
    if says is None:  # where the robot stands in the world is not the plan's business
        driver.connect()
        return
    with pytest.raises(IdentityError, match=says):
        driver.connect()
    assert fake.report()["mb_last"] == 0


def test_tool_and_base_do_not_disturb_the_check_of_the_flange(eki_cell):
    eki_cell(
        controller={
            "tools": {"1": (10, -20, 264.8, 30, 5, -170)},
            "bases": {"0": (500, 200, -100, 20, 10, -5)},
            "robroot": (0, 0, 700, 15, 0, 0),
        }
    )


def test_a_program_that_does_not_run_is_waited_for(eki_cell):
    fake, robot = eki_cell(controller={"running": False}, connect=False, robot={"connect_timeout_s": 0.5})
    with pytest.raises(ConnectError, match="select mbcacq_eki on the smartPAD and start it"):
        robot.connect()
    robot._options = robot._options.__class__(**{**robot._options.__dict__, "connect_timeout_s": 20.0})
    threading.Timer(0.3, lambda: fake.inject(restart=1)).start()
    robot.connect()
    robot.move_to(FAR, motion_limits())
    arrive(robot)


def test_nobody_there():
    port = free_port()
    robot = KukaEki(
        "arm",
        "",
        {"address": "127.0.0.1", "port": port, "limits_deg": EKI_LIMITS_DEG, "speed_deg_s": SPEED_DEG_S, "connect_timeout_s": 0.2},
    )
    with pytest.raises(ConnectError, match="cannot be reached"):
        robot.connect()
    robot.stop()
    robot.close()
    assert len(robot.cycles()) == 0


GOOD = {"address": "10.0.0.1", "limits_deg": EKI_LIMITS_DEG, "speed_deg_s": SPEED_DEG_S}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"adress": "x"}, "unknown option 'adress'"),
        ({"address": ""}, "address is missing"),
        ({"limits_deg": None}, "limits_deg"),
        ({"speed_deg_s": None}, "speed_deg_s"),
        ({"speed_deg_s": [0] * 6}, "positive"),
        ({"limits_deg": [(1, 0)] * 6}, "lower limit"),
        ({"mode": "T3"}, "mode must be"),
        ({"mode": []}, "mode must be"),
        ({"tool": -1}, "tool"),
        ({"port": True}, "port"),
        ({"override": 0}, "override"),
        ({"beat_ms": 600}, "beat_ms"),
        ({"kinematics": [[1, 2]]}, "kinematics"),
        ({"acceleration_percent": 2.5}, "acceleration_percent"),
        ({"tool_frame": [1, 2, float("nan"), 0, 0, 0]}, "tool_frame"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_opened(options, says):
    with pytest.raises(ConfigError, match=says):
        KukaEki("arm", "", {**GOOD, **options})


def test_before_connecting():
    robot = KukaEki("arm", "", GOOD)
    assert robot.describe().kind == "robot"
    assert not robot.describe().verified_on_hardware
    with pytest.raises(ConnectError, match="call connect first"):
        robot.move_to(HOME, motion_limits())


def test_the_bytes_of_a_command():
    assert telegrams.command(telegrams.PTP, 7, 96, 30.0, 50, (1.5, -90, 90, 0, 1, 0)) == (
        b'<Command Kind="1" Id="7" Beat="96" Speed="30.000000" Accel="50"><Axis A1="1.500000" A2="-90.000000" A3="90.000000" A4="0.000000" '
        b'A5="1.000000" A6="0.000000"></Axis></Command>'
    )


STATE = (
    b'<Robot><State Base="0" Beat="7" Cancelled="0" Code="0" Done="0" Drives="1" EmergencyStop="0" GuardStop="0" Last="0" Mode="4" Moving="0" '
    b'Override="100" Ready="1" Refused="0" Session="1" Time="5060" Tool="1"><Axis A1="1.5" A2="-90" A3="90" A4="0" A5="0" A6="0"></Axis>'
    b'<Cart A="0" B="0" C="0" X="1" Y="2" Z="3"></Cart><Current A1="0" A2="11" A3="11" A4="0" A5="2.5" A6="0"></Current></State></Robot>'
)


@hypothesis_settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, len(STATE) - 1), st.integers(0, 255)), max_size=4), st.integers(0, len(STATE)), st.integers(1, 400)
)
def test_spoilt_telegrams_are_read_or_refused_and_nothing_else(changes, cut, size):
    data = bytearray(STATE)
    for where, value in changes:
        data[where] = value
    stream, cutter = STATE + bytes(data[:cut]) + STATE, Cutter("Robot")
    found = []
    try:
        for k in range(0, len(stream), size):
            found += [telegrams.parse(t) for t in cutter.feed(stream[k : k + size])]
    except ValueError:  # BadTelegram, FramingError: ours
        pass
    assert not found or found[0][1].axis == (1.5, -90.0, 90.0, 0.0, 0.0, 0.0)
    for _, state in found:
        assert state is None or np.isfinite([*state.axis, *state.cart, *state.current]).all()
