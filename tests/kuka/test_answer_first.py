"""The next answer is there before its telegram: what that saves, and the one cycle of dead time that it costs."""

import numpy as np
import pytest
from mbcacq_kuka.rsi.motion import RsiMotion
from mbcacq_kuka.rsi.shared import ARRIVED, MOVE, STOP, RsiCommand
from mbcacq_kuka.rsi.telegram import Parser
from rsi_bench import ACCELERATION, JERK, LIMITS, SOURCE, SPEED, START, Bench, T

TARGET = (40.0, *START[1:])


@pytest.fixture
def one():
    made = Bench()
    yield made
    made.shared.close()


def command(kind, settle_s=0.0):
    return RsiCommand(kind, TARGET, (SPEED,) * 6, (ACCELERATION,) * 6, (JERK,) * 6, 0.01, settle_s)


def test_an_expected_telegram_is_answered_before_it_is_parsed(one, monkeypatch):
    parsed, parse = [], Parser.parse
    monkeypatch.setattr(Parser, "parse", lambda self, data: parsed.append(data) or parse(self, data))
    one.ipoc += 4
    telegram = one.telegram()
    assert one.session.reply(telegram, SOURCE, one.ipoc * 1e-3).endswith(b"<IPOC>%d</IPOC></Sen>" % one.ipoc)
    assert parsed == []
    one.session.digest(one.ipoc * 1e-3)
    assert parsed == [telegram]


@pytest.mark.parametrize(
    "change", [lambda one: setattr(one, "delay", 1), lambda one: setattr(one, "ipoc", one.ipoc + 4)], ids=["another Delay", "a gap"]
)
def test_any_other_telegram_is_parsed_first(one, monkeypatch, change):
    parsed, parse = [], Parser.parse
    monkeypatch.setattr(Parser, "parse", lambda self, data: parsed.append(data) or parse(self, data))
    one.ipoc += 4
    change(one)
    assert one.session.reply(one.telegram(), SOURCE, one.ipoc * 1e-3) is not None
    assert len(parsed) == 1


def test_after_a_rejected_answer_the_motion_goes_on_from_what_the_controller_held(one):
    one.shared.send(command(MOVE))
    for _ in range(60):
        one.cycle()
    held = one.sent[-1]
    one.cycle(accepted=False)
    for _ in range(10):  # whether it has taken the answer is seen from the arm, not from its count
        assert one.cycle() == held
    for _ in range(20):
        one.cycle()
    assert one.sent[-1][0] > held[0]


def test_a_motion_begins_one_cycle_after_the_telegram_that_followed_its_command(one):
    one.shared.send(command(MOVE))
    before = len(one.sent)
    for _ in range(4):
        one.cycle()
    assert [correction[0] > 0.0 for correction in one.sent[before:]] == [False, True, True, True]


@pytest.mark.parametrize("cycles", [20, 60, 80])
def test_the_distance_of_a_stop_is_that_of_braking_and_of_one_cycle(one, cycles):
    one.shared.send(command(MOVE))
    for _ in range(cycles):
        one.cycle()
    before = len(one.sent)
    one.shared.send(command(STOP))
    for _ in range(400):
        one.cycle()
    ideal = RsiMotion(START, T, LIMITS)  # the same motion, braked after the answer that was rendered when the command came
    ideal.move(command(MOVE))
    while ideal.position[0] < one.sent[before][0] - 1e-6:
        ideal.step()
    started = ideal.position[0]
    ideal.stop()
    while ideal.moving:
        ideal.step()
    path = np.array(one.sent)[:, 0]
    assert path[-1] == pytest.approx(ideal.position[0], abs=1e-5)
    dead_time = path[before] - path[before - 1]
    assert path[-1] - path[before - 1] == pytest.approx(ideal.position[0] - started + dead_time, abs=1e-5)
    assert 0.0 < dead_time <= SPEED * T * 1.001


def arrived(one):
    ring = np.frombuffer(one.shared.ring).reshape(one.shared.capacity, one.shared.width)
    flags = bool(int(ring[(one.shared.head - 1) % one.shared.capacity][2]) & ARRIVED)
    del ring
    return flags


def test_arrival_counts_from_the_first_telegram_after_the_last_set_point(one):
    one.shared.send(command(MOVE))
    while one.sent[-1][0] != pytest.approx(TARGET[0], abs=1e-9):
        one.cycle()
    assert not arrived(one)  # the telegram that was answered with the last set point cannot know of it
    one.cycle()
    assert not arrived(one)
    one.cycle()
    assert arrived(one)


def test_there_is_no_arrival_while_the_last_set_point_is_rejected(one):
    one.shared.send(command(MOVE))
    for _ in range(400):
        one.cycle()
        if TARGET[0] - one.sent[-1][0] < 0.005:  # within the tolerance, but not there
            break
    near = one.q
    for _ in range(50):
        one.cycle(accepted=False)
        one.q = near
        assert not arrived(one)
    for _ in range(60):
        one.cycle()
    assert arrived(one)
