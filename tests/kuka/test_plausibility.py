"""Angles that an arm cannot have are noticed in time, and a lag of any shape is taken for what it is. One session, without sockets."""

import numpy as np
import pytest
from mbcacq_kuka.rsi.watch import Follow
from rsi_bench import SPEED, START, Bench, T

FAR = (170.0, *START[1:])


@pytest.fixture
def bench():
    one = Bench()
    yield one
    one.shared.close()


def until_fault(one, cycles=400):
    for k in range(cycles):
        one.cycle()
        if one.shared.fault() is not None:
            return k
    return None


def freeze(one):
    where = one.q
    cycle = one.cycle

    def frozen(*args, **given):
        answer = cycle(*args, **given)
        one.q = where
        return answer

    one.cycle = frozen


@pytest.mark.parametrize("axis", [0, 4])
def test_a_jump_of_thirty_degrees_in_one_cycle_stops_the_arm_at_once(bench, axis):
    for _ in range(10):
        bench.cycle()
    bench.q = tuple(v + (30.0 if k == axis else 0.0) for k, v in enumerate(START))
    assert until_fault(bench) == 0
    assert bench.shared.fault()["kind"] == "implausible"
    assert f"A{axis + 1} jumped by 30.00°" in bench.shared.fault()["text"]


def test_an_arm_that_freezes_in_motion_is_noticed_within_six_degrees(bench):
    bench.move(FAR)
    for _ in range(150):
        bench.cycle()
    freeze(bench)
    before = bench.sent[-1][0]
    until_fault(bench)
    assert bench.shared.fault()["kind"] == "follow"
    assert bench.sent[-1][0] - before < 6.5


def test_an_arm_that_never_begins_is_noticed_within_eleven_degrees(bench):
    freeze(bench)
    bench.move(FAR)
    until_fault(bench)
    assert bench.shared.fault()["kind"] == "follow"
    assert bench.sent[-1][0] < 11.0


def test_an_arm_that_drifts_away_without_a_command_is_noticed(bench):
    for k in range(60):
        bench.q = (0.1 * k, *START[1:])
        bench.cycle()
        bench.q = (0.1 * k, *START[1:])
    assert bench.shared.fault()["kind"] == "follow"


@pytest.mark.parametrize("lag_s", [0.0, 0.02, 0.03])
@pytest.mark.parametrize("decimals", [1, 6])
def test_a_lag_and_rounding_are_no_fault(lag_s, decimals):
    """A first-order lag, a dead time of two cycles, angles rounded to a tenth of a degree, motions of every speed."""
    follow = Follow(START, 0.5, 25, 0.1, T)
    rng = np.random.default_rng(0)
    position, measured, dead = np.array(START), np.array(START), [np.array(START)] * 2
    share = 1.0 if lag_s == 0.0 else 1.0 - np.exp(-T / lag_s)
    for _ in range(30):
        speed, cycles = rng.uniform(-SPEED, SPEED, 6), int(rng.integers(5, 120))
        ramp = np.minimum(np.minimum(np.arange(cycles), np.arange(cycles)[::-1]) / 10.0, 1.0)
        for scale in ramp:
            position = position + speed * scale * T
            dead.append(position)
            measured = measured + share * (dead.pop(0) - measured)
            assert follow.check(tuple(position), tuple(np.round(measured, decimals))) is None


@pytest.mark.parametrize("gap", [1, 3, 8, 30])
def test_a_lag_across_a_gap_is_no_fault(gap):
    """While telegrams are missing the controller holds its set point and the arm catches up."""
    follow = Follow(START, 0.5, 25, 0.1, T)
    position, measured, share = np.array(START), np.array(START), 1.0 - np.exp(-T / 0.03)
    speed = np.array([300.0, 0, 0, 0, 0, 0])
    for k in range(1, 400):
        if k % 60 == 0:
            for _ in range(gap):
                measured = measured + share * (position - measured)
            follow.skip(tuple(measured), gap)
        position = position + speed * T * min(1.0, (k % 60) / 20.0)
        measured = measured + share * (position - measured)
        assert follow.check(tuple(position), tuple(measured)) is None
