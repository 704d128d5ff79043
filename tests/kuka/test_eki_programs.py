"""What the KRL programs do, run from the shipped files: the queue, the refusals, stops, lost connections, on both systems."""

import numpy as np
import pytest
from eki_bench import HOME, SYSTEMS, Bench

FAR = (5.0, *HOME[1:])


@pytest.fixture(params=SYSTEMS)
def bench(request):
    opened = []

    def make(**more):
        opened.append(Bench(request.param, **more))
        opened[-1].dial()
        return opened[-1]

    yield make
    for one in opened:
        one.close()


def test_it_introduces_itself_and_tells_its_state(bench):
    one = bench(model="#KR10R1100_2 C4 SV")
    one.ticks(9)
    said = one.hear()
    assert '<Hello Axes="6" Interface="mbcacq 3"' in said
    assert 'Model="#KR10R1100_2 C4 SV" Session="1"' in said
    one.ticks(60)
    states = one.hear().count("<State ")
    assert states == 10  # 240 ms, one in 24 ms
    assert one.last("Ready") == 1
    assert one.last("Beat") == 7


def test_the_bytes_of_a_state():
    """As EKI 3 sends it: only the sub-tree, attributes alphabetically, opened and closed."""
    one = Bench("kss", start_deg=(1.5, *HOME[1:]), dh=(), clock_ms=5000)
    one.dial()
    one.ticks(6)
    first = one.hear().split("</Robot>")[1] + "</Robot>"
    one.close()
    assert first.startswith(
        '<Robot><State Base="0" Beat="7" Cancelled="0" Code="0" Done="0" Drives="1" EmergencyStop="0" GuardStop="0" Last="0" LoadKg="0.000000" Mode="4" '
        'Moving="0" Override="100" Ready="1" Refused="0" Session="1" SwitchCode="0" Switched="0" Time="5060" Tool="1"><Axis A1="1.500000" A2="-90.000000" '
        'A3="90.000000" A4="0.000000" A5="0.000000" A6="0.000000"></Axis><Cart A="0.000000" B="-0.000000" C="0.000000" X="0.000000" Y="0.000000" Z="0.000000"></Cart><Current A1="'
    )
    assert first.endswith("</Current></State></Robot>")


def test_a_move_is_driven_and_counted(bench):
    one = bench()
    one.say(kind=1, number=1, axes=(3.0, *HOME[1:]))
    assert one.last("Moving") == 1
    assert one.until(lambda: one.variables.mb_done == 1)
    assert one.q()[0] < 2.99  # the set point is there, the arm is not yet
    assert one.until(lambda: one.controller.system.rob_stopped)
    np.testing.assert_allclose(one.q(), (3.0, *HOME[1:]), atol=1e-4)


def test_moves_wait_in_a_queue_of_eight_and_the_ninth_is_refused(bench):
    one = bench()
    one.say(kind=1, number=1, axes=FAR)
    for k in range(2, 9):
        one.say(kind=1, number=k, axes=(5.0 - 0.1 * k, *HOME[1:]), ticks=3)
    one.say(kind=1, number=9, axes=HOME, ticks=6)
    assert (one.variables.mb_last, one.variables.mb_refused, one.variables.mb_code) == (8, 9, 13)
    assert one.until(lambda: one.variables.mb_done == 8 and one.controller.system.rob_stopped, 20000)
    assert one.q()[0] == pytest.approx(4.2, abs=0.01)


@pytest.mark.parametrize(
    ("what", "code"),
    [
        ({"axes": (5.2, *HOME[1:])}, 1),
        ({"axes": (0.0, -90.0, 96.0, 0.0, 0.0, 0.0)}, 3),
        ({"axes": (*HOME[:5], -5.2)}, 6),
        ({"kind": 7}, 10),
        ({"speed": 31.0}, 11),
        ({"speed": 0.0}, 11),
        ({"kind": 2}, 10),
        ({"accel": 51}, 12),
        ({"accel": 0}, 12),
        ({"number": 0}, 15),
    ],
)
def test_what_the_plan_does_not_allow_is_refused(bench, what, code):
    one = bench()
    one.say(**{"kind": 1, "number": 4, **what}, ticks=9)
    assert (one.variables.mb_refused, one.variables.mb_code) == (what.get("number", 4), code)
    assert one.q() == list(HOME)


def test_no_move_without_the_robot_program(bench):
    one = bench(running=False)
    assert one.last("Ready") == 0
    one.say(kind=1, number=1, axes=FAR)
    assert one.variables.mb_code == 14


def moving(one, number=1):
    one.say(kind=1, number=number, speed=10.0, axes=FAR, ticks=36)
    assert 0.5 < one.q()[0] < 3.5


def test_stop_brakes_on_the_path_and_the_next_move_works(bench):
    one = bench()
    moving(one)
    one.say(kind=3, number=1)
    speeds = []
    while not one.controller.system.rob_stopped:
        before = one.q()
        one.ticks(1)
        speeds.append((one.q()[0] - before[0]) / 0.004)
    assert one.q()[0] < 4.9
    assert one.q()[1:] == pytest.approx(HOME[1:], abs=1e-6)
    assert np.abs(np.diff(speeds)).max() / 0.004 < 1.1 * 0.5 * 200.0 / 0.3  # braked with the ramp, not dropped
    assert one.last("Cancelled") == 1
    one.say(kind=1, number=2, axes=(-1.0, *HOME[1:]))
    assert one.until(lambda: one.variables.mb_done == 2 and one.controller.system.rob_stopped)
    assert one.q()[0] == pytest.approx(-1.0, abs=0.01)


def test_stop_forgets_the_moves_that_wait_but_not_the_one_sent_after_it(bench):
    one = bench()
    moving(one)
    for k in (2, 3):
        one.say(kind=1, number=k, axes=(-4.0, *HOME[1:]), ticks=0)
    one.say(kind=3, number=3, ticks=0)
    one.say(kind=1, number=4, axes=(0.5, *HOME[1:]), ticks=3)
    lowest = []
    assert one.until(lambda: lowest.append(one.q()[0]) or one.variables.mb_done == 4)
    assert min(lowest) > -1e-6
    assert one.until(lambda: one.controller.system.rob_stopped)
    assert one.q()[0] == pytest.approx(0.5, abs=0.01)


def test_stopping_twice_or_at_rest_changes_nothing(bench):
    one = bench()
    for _ in range(3):
        one.say(kind=3, number=0)
    moving(one)
    for _ in range(20):
        one.say(kind=3, number=1, ticks=3)
    assert one.until(lambda: one.controller.system.rob_stopped)
    one.say(kind=1, number=2, axes=HOME)
    assert one.until(lambda: one.variables.mb_done == 2)
    assert one.controller.channel.overflowed == 0


@pytest.mark.parametrize("end", ["close", "reset"])
def test_a_lost_connection_brakes_the_arm_and_the_channel_is_made_new(bench, end):
    one = bench()
    moving(one)
    if end == "close":
        one.socket.close()
    else:
        one.controller.faults.inject({"reset": 1})
    opened = one.controller.channel.opened
    one.ticks(150)
    assert one.controller.system.rob_stopped
    assert 0.5 < one.q()[0] < 4.9
    assert one.controller.channel.opened == opened + 1
    one.dial()
    one.ticks(9)
    assert "<Hello " in one.hear()
    one.say(kind=1, number=5, axes=HOME)
    assert one.until(lambda: one.variables.mb_done == 5)


def test_a_silent_computer_is_as_good_as_gone(bench):
    one = bench()
    moving(one)
    one.ticks(260)  # a second without a word
    assert one.controller.channel.opened == 2
    one.ticks(100)
    assert one.controller.system.rob_stopped
    assert one.q()[0] < 5.01


def test_one_client_at_a_time(bench):
    one = bench()
    with pytest.raises(ConnectionRefusedError):
        one.dial()


def test_a_full_buffer_closes_the_connection_but_keeps_the_datum_that_broke_it():
    one = Bench("kss")
    one.dial()
    channel = one.controller.channel
    for k in range(17):
        one.say(kind=1, number=k + 1, ticks=0)
    channel.poll()
    assert channel.client is None
    assert channel.overflowed == 1
    assert len(channel.buffers["Command/@Kind"]) == 17
    one.close()


def test_junk_halves_and_several_at_once(bench):
    one = bench()
    one.say(kind=0, extra=b"\n\0\0 x > y </Command>\xff" + bytes(300))
    one.say(kind=1, number=1, axes=FAR, ticks=0)
    one.say(kind=3, number=1, ticks=0)
    one.say(kind=1, number=2, axes=(1.0, *HOME[1:]), ticks=0)
    whole = b'<Command Kind="3" Id="2" Beat="7" Speed="1" Accel="1"><Axis A1="0" A2="0" A3="0" A4="0" A5="0" A6="0"/></Command>'
    for k in range(0, len(whole), 9):
        one.send(whole[k : k + 9])
        one.ticks(3)
    assert one.variables.mb_last == 2
    assert one.variables.mb_cancelled == 2


@pytest.mark.parametrize(
    "broken",
    [
        b'<Command Kind="1" Id="1" Beat="7" Speed="20"><Frame>{X 1,Y 2,Z 3,A 0,B 0,C 0}</Frame></Command>',
        b"<Command>&lol;</Command>",
        b'<!DOCTYPE x [<!ENTITY a "b">]><Command Kind="1"></Command>',
        b"<Command Kind='1' <",
    ],
)
def test_broken_commands_move_nothing(bench, broken):
    one = bench()
    one.send(broken + b" " * 50)
    one.ticks(200)
    assert one.variables.mb_last == 0
    assert one.q() == list(HOME)


def test_endless_commands_close_the_connection(bench):
    one = bench()
    for _ in range(5):
        one.send(b"<Command " + b"x" * 5000)
        one.ticks(3)
    assert one.controller.channel.overflowed == 1


def test_emergency_stop_and_a_new_start(bench):
    one = bench()
    moving(one)
    one.controller.faults.inject({"emergency_stop": 1})
    one.ticks(150)
    assert one.controller.system.rob_stopped
    assert (one.last("EmergencyStop"), one.last("Ready"), one.last("Drives")) == (1, 0, 0)
    one.controller.faults.inject({"emergency_stop": 0, "restart": 1})
    one.say(kind=0, ticks=30)
    said = one.hear()
    assert 'Session="2"' in said
    one.say(kind=1, number=2, axes=HOME)
    assert one.until(lambda: one.variables.mb_done == 2)
