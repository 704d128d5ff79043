"""Digital outputs over RSI: switched by the answer, seen in the telegram, and off whenever the session ends or an answer is missing."""

import re
import threading
import time

import pytest
from kuka_bench import HOME_DEG, wait
from rsi_bench import Bench

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout


@pytest.fixture
def bench():
    one = Bench(digital_outputs=(12, 3))
    yield one
    one.shared.close()


def outputs(answer):
    return re.search(rb"<DiO [^>]*/>", answer)[0]


def answer(one):
    one.ipoc += 4
    return one.reply(one.telegram())


def test_a_session_switches_what_the_memory_says_and_nothing_at_first(bench):
    assert outputs(answer(bench)) == b'<DiO o12="0" o3="0"/>'
    bench.shared.outputs = 0b10
    answer(bench)  # was rendered before
    assert outputs(answer(bench)) == b'<DiO o12="0" o3="1"/>'
    bench.shared.outputs = 0
    answer(bench)
    assert outputs(answer(bench)) == b'<DiO o12="0" o3="0"/>'


@pytest.mark.parametrize("end", ["closed", "a telegram without AIPos", "late answers"])
def test_a_session_that_ends_switches_everything_off(end):
    one = Bench(digital_outputs=(3,), late_limit=5)
    one.shared.outputs = 1
    answer(one)
    assert outputs(answer(one)) == b'<DiO o3="1"/>'
    if end == "closed":
        one.session.close(one.ipoc * 1e-3)
        answer(one)
    elif end == "late answers":
        while one.shared.fault() is None:
            one.cycle(accepted=False)
    else:
        one.cycle(b'<Rob Type="KUKA"><Delay D="0"/><IPOC>%d</IPOC></Rob>' % (one.ipoc + 4))
    answers = [answer(one) for _ in range(20)]
    assert {outputs(a) for a in answers if a is not None} == {b'<DiO o3="0"/>'}
    one.shared.close()


def test_without_outputs_in_the_plan_an_answer_says_nothing_of_them():
    one = Bench()
    one.shared.outputs = -1
    assert b"DiO" not in answer(one) + answer(one) + answer(one)
    one.shared.close()


def test_a_pulse_at_the_wire_is_seen_and_recorded(cell):
    krc, robot = cell(krc={"digital_outputs": (3, 12)}, robot={"digital_outputs": [12, 3]})
    robot.set_output(12, True)
    assert krc.state.output(12) == (True, 1)
    robot.set_output(12, False)
    assert krc.state.output(12) == (False, 1)
    assert krc.state.output(3) == (False, 0)
    reported = robot.cycles().columns["digital_outputs"]
    assert reported[:, 1].max() == 1  # in the order of the telegram: 3, 12
    assert reported[-1].tolist() == [0, 0]
    assert "digital_outputs" in {field.name for field in robot.describe().fields}
    with pytest.raises(ConfigError, match="output 4 may not be switched from here; add it to the option digital_outputs"):
        robot.set_output(4, True)
    assert robot.state().q == pytest.approx([v * 3.141592653589793 / 180 for v in HOME_DEG], abs=1e-4)  # nothing moved


def test_answers_that_are_lost_switch_it_off_and_the_next_one_on_again(cell):
    krc, robot = cell(krc={"digital_outputs": (3,), "timeout": 100_000}, robot={"digital_outputs": [3], "late_limit": 100_000})
    robot.set_output(3, True)
    krc.inject(drop_answers=1.0)
    wait(lambda: not krc.state.output(3)[0])
    krc.inject(drop_answers=0.0)
    wait(lambda: krc.state.output(3) == (True, 2))
    robot.set_output(3, False)
    assert krc.state.output(3) == (False, 2)


def test_a_controller_that_switches_nothing_is_named_and_asked_no_longer(cell):
    krc, robot = cell(krc={"digital_outputs": (3,)}, robot={"digital_outputs": [3], "silence_s": 5.0})
    krc.inject(stuck=1)
    with pytest.raises(DeviceTimeout, match="output 3 was switched on, but the controller reports it off; is it write-protected"):
        robot.set_output(3, True)
    for stuck in (0, 0):  # what was still on its way came while it was stuck
        before = krc.report()["cycles"]
        wait(lambda before=before: krc.report()["cycles"] > before + 50)
        krc.inject(stuck=stuck)
    assert krc.state.output(3) == (False, 0)


def test_stop_while_it_waits_is_said(cell):
    krc, robot = cell(krc={"digital_outputs": (3,)}, robot={"digital_outputs": [3], "silence_s": 60.0})
    krc.inject(stuck=1)
    threading.Timer(0.2, robot.stop).start()
    with pytest.raises(DeviceFault, match="output 3 was switched off meanwhile"):
        robot.set_output(3, True)


def test_a_program_that_dies_in_a_pulse_leaves_it_off(cell):
    """The cycle process ends the session in order when its driver is gone."""
    krc, robot = cell(krc={"digital_outputs": (3,)}, robot={"digital_outputs": [3]})
    robot.set_output(3, True)
    process = robot._process._process
    process.input.close()
    wait(lambda: not krc.state.output(3)[0])


def test_files_from_before_are_refused_before_anything_moves(cell):
    with pytest.raises(ConnectError, match=r"do not report output 3 \(Digout\), so the files .* copy those that `mbcacq controller-files`"):
        cell(krc={"digital_outputs": (12,)}, robot={"digital_outputs": [12, 3]})


def test_a_plan_without_outputs_runs_on_files_with_them(cell):
    krc, robot = cell(krc={"digital_outputs": (3,)})
    time.sleep(0.02)
    assert not robot.state().moving
    assert krc.state.output(3) == (False, 0)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([0], "whole numbers from 1 to 4096"),
        ([True], "whole numbers"),
        ("3", "must be a list"),
        ([3, 3], "each once"),
        (list(range(1, 10)), "up to 8"),
    ],
)
@pytest.mark.parametrize("driver", ["rsi", "eki"])
def test_outputs_that_cannot_be_are_named(driver, given, says):
    from mbcacq_kuka.eki.driver import KukaEki
    from mbcacq_kuka.rsi.driver import KukaRsi

    options = {"limits_deg": [[-1, 1]] * 6} | ({} if driver == "rsi" else {"address": "127.0.0.1", "speed_deg_s": [1] * 6})
    make = KukaRsi if driver == "rsi" else KukaEki
    with pytest.raises(ConfigError, match=f"digital_outputs.* {says}"):
        make("arm", "", {**options, "digital_outputs": given})
    with pytest.raises(ConfigError, match="only followed is sent nothing"):
        make("arm", "", {**options, "digital_outputs": [3], "follow": True})
