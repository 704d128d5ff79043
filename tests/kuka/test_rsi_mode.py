"""Absolute or relative, moving or still: what the session learns of the controller and of its arm before and while it moves."""

import re

import numpy as np
import pytest
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import CLOSE, MOVE, MOVING, STOP, RsiCommand, Shared
from rsi_bench import LIMITS, SOURCE, START, Bench

FAR = (100.0, *START[1:])


class Arm:
    """A controller of either kind with an arm that lags, and measured angles with noise. ``ended``: Stop was received."""

    def __init__(self, relative=False, lag_s=0.0, noise_deg=0.0, decimals=6, **options):
        self.shared = Shared.create()
        self.session = RsiSession(self.shared, RsiOptions(limits_deg=LIMITS, **options).settings())
        self.relative, self.share, self.noise, self.decimals = relative, 1.0 - np.exp(-0.004 / lag_s) if lag_s else 1.0, noise_deg, decimals
        self.set_point, self.q, self.ipoc, self.ended, self.delay = np.array(START), np.array(START), 1000, False, 0
        self.rng = np.random.default_rng(3)
        self.deaf = False

    def cycle(self, cycles=1):
        for _ in range(cycles):
            self.ipoc += 4
            shown = self.q + self.noise * self.rng.standard_normal(6)
            axes = " ".join(f'A{i + 1}="{v:.{self.decimals}f}"' for i, v in enumerate(shown))
            answer = self.session.reply(
                f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="{self.delay}"/><IPOC>{self.ipoc}</IPOC></Rob>'.encode(),
                SOURCE,
                self.ipoc * 1e-3,
            )
            self.session.digest(self.ipoc * 1e-3)
            if answer is not None and not self.ended and not self.deaf:
                correction = np.array([float(v) for v in re.findall(rb'A\d="([^"]+)"', answer)])
                self.ended = b"<Stop>1<" in answer
                self.set_point = correction + (self.set_point if self.relative else START)
            self.q = self.q + self.share * (self.set_point - self.q)

    def connect(self):
        while not self.session.connected and self.shared.fault() is None:
            self.cycle()

    def move(self, target=FAR):
        self.shared.send(RsiCommand(MOVE, target, (100.0,) * 6, (400.0,) * 6, (4000.0,) * 6, 0.01, 0.1))


@pytest.fixture
def arm():
    made = []

    def make(**given):
        made.append(Arm(**given))
        return made[-1]

    yield make
    for one in made:
        one.shared.close()


@pytest.mark.parametrize("lag_s", [0.0, 0.012, 0.1])
@pytest.mark.parametrize(("noise_deg", "decimals"), [(0.0, 6), (0.0005, 4), (0.002, 3), (0.0005, 2)])
def test_a_relative_controller_is_named_before_anything_moves(arm, lag_s, noise_deg, decimals):
    one = arm(relative=True, lag_s=lag_s, noise_deg=noise_deg, decimals=decimals)
    one.connect()
    assert "RSI_ON(#RELATIVE)" in one.shared.fault()["text"]
    stands = one.set_point
    one.cycle(200)
    np.testing.assert_array_equal(one.set_point, stands)
    assert np.abs(stands - START).max() <= 0.05
    assert one.ended


@pytest.mark.parametrize("lag_s", [0.0, 0.012, 0.1])
@pytest.mark.parametrize(("noise_deg", "decimals"), [(0.0, 6), (0.0005, 4), (0.002, 3), (0.0005, 2)])
def test_an_absolute_controller_is_back_where_it_was(arm, lag_s, noise_deg, decimals):
    one = arm(lag_s=lag_s, noise_deg=noise_deg, decimals=decimals)
    one.connect()
    assert one.shared.fault() is None
    np.testing.assert_allclose(one.set_point, START, atol=5e-3)


@pytest.mark.parametrize("lag_s", [0.0, 0.02, 0.1, 0.15])
@pytest.mark.parametrize("steps_later", [0, 1, 30])
def test_a_relative_controller_that_was_not_yet_moving_when_it_was_probed_is_named_before_the_motion_begins(arm, lag_s, steps_later):
    one = arm(relative=True, lag_s=lag_s)
    one.deaf = True  # RSI_MOVECORR was not reached
    one.connect()
    one.cycle(3)
    one.move()
    one.cycle(steps_later)
    one.deaf = False
    while one.shared.fault() is None:
        one.cycle()
    decided = one.set_point
    assert one.shared.fault()["kind"] == "relative"
    one.cycle(300)
    np.testing.assert_array_equal(one.set_point, decided)
    assert np.abs(one.set_point - START).max() < 0.5
    assert one.ended


def test_an_arm_that_carries_corrections_out_only_later_moves_once_that_is_seen(arm):
    one = arm(lag_s=0.02, noise_deg=0.0005)
    one.deaf = True
    one.connect()
    one.move()
    one.cycle(150)
    assert moving(one)
    one.deaf = False
    one.cycle(1200)
    assert one.shared.fault() is None
    np.testing.assert_allclose(one.set_point, FAR, atol=1e-3)


def test_stop_ends_the_wait_for_an_arm_that_carries_nothing_out(arm):
    one = arm()
    one.deaf = True
    one.connect()
    one.move()
    one.cycle(30)
    one.shared.send(RsiCommand(STOP))
    one.cycle(30)
    one.deaf = False
    one.cycle(600)
    assert one.shared.fault() is None
    np.testing.assert_allclose(one.set_point, START, atol=0.017)
    assert not moving(one)


@pytest.mark.parametrize("relative", [False, True])
def test_whoever_goes_away_during_the_bump_leaves_a_correction_of_zero_and_stop(arm, relative):
    one = arm(relative=relative)
    one.cycle(18)
    assert np.abs(one.set_point - START).max() > 1e-4  # the bump is under way
    one.session.close(one.ipoc * 1e-3)
    one.cycle(1)
    assert one.ended
    decided = one.set_point
    one.cycle(60)
    np.testing.assert_array_equal(one.set_point, decided)
    assert one.session.over


@pytest.mark.parametrize("lag_s", [0.0, 0.1])
@pytest.mark.parametrize("how", [STOP, CLOSE])
def test_a_stop_during_the_proof_goes_back_to_zero_at_which_a_relative_arm_stands(arm, lag_s, how):
    one = arm(relative=True, lag_s=lag_s)
    one.deaf = True
    one.connect()
    one.move()
    one.cycle(13)
    one.deaf = False
    one.cycle(2)
    assert np.abs(one.set_point - START).max() > 1e-4
    one.shared.send(RsiCommand(how))
    one.cycle(30)
    stands = one.set_point
    one.cycle(300)
    np.testing.assert_array_equal(one.set_point, stands)
    assert np.abs(stands - START).max() < 0.35


@pytest.mark.parametrize(("noise_deg", "decimals"), [(0.0, 6), (0.0005, 4), (0.002, 3), (0.0005, 2)])
@pytest.mark.parametrize("lag_s", [0.0, 0.03])
def test_a_motion_is_not_refused_for_angles_that_are_noisy_or_rounded(arm, noise_deg, decimals, lag_s):
    one = arm(lag_s=lag_s, noise_deg=noise_deg, decimals=decimals)
    one.connect()
    one.move()
    one.cycle(2200)
    assert one.shared.fault() is None
    np.testing.assert_allclose(one.set_point, FAR, atol=0.006)


def test_an_arm_that_never_carried_anything_out_has_the_names_to_compare_named(arm):
    one = arm()
    one.deaf = True
    one.connect()
    one.move()
    while one.shared.fault() is None:
        one.cycle()
    assert one.shared.fault()["kind"] == "follow"
    assert "sen_type 'ImFree'" in one.shared.fault()["text"]
    assert "correction 'AK'" in one.shared.fault()["text"]
    np.testing.assert_array_equal(one.set_point, START)


def test_angles_that_jump_while_a_motion_begins_are_no_relative_controller(arm):
    one = arm(lag_s=0.02)
    one.connect()
    one.move()
    one.cycle(18)
    one.q = one.q + np.array([30.0, 0, 0, 0, 0, 0])
    one.cycle(2)
    assert one.shared.fault()["kind"] == "implausible"


def test_an_arm_that_does_not_follow_gets_no_set_point_any_more(arm):
    one = arm()
    one.connect()
    one.move()
    one.cycle(40)
    one.deaf = True
    while one.shared.fault() is None:
        one.cycle()
    stood, one.deaf = one.q, False
    one.cycle(2)
    assert one.ended
    assert one.shared.fault()["kind"] == "follow"
    assert np.abs(one.session._points.sent[0] - stood[0]) < 12.0
    asked = one.set_point
    one.cycle(300)
    np.testing.assert_array_equal(one.set_point, asked)


def test_an_arm_that_never_moves_has_the_names_to_compare_named(arm):
    one = arm()
    one.connect()
    one.deaf = True
    one.move()
    while one.shared.fault() is None:
        one.cycle()
    assert "sen_type 'ImFree'" in one.shared.fault()["text"]
    assert "correction 'AK'" in one.shared.fault()["text"]


def test_a_controller_that_discards_every_answer_is_found_at_once(arm):
    one = arm()
    one.deaf = True
    while one.shared.fault() is None:
        one.cycle()
        one.delay += 1
    assert "discards every answer" in one.shared.fault()["text"]
    assert "sen_type 'ImFree'" in one.shared.fault()["text"]


def moving(one):
    ring = np.frombuffer(one.shared.ring).reshape(one.shared.capacity, one.shared.width)
    flags = int(ring[(one.shared.head - 1) % one.shared.capacity][2])
    del ring
    return bool(flags & MOVING)


@pytest.mark.parametrize("noise_deg", [0.0, 0.0005, 0.002, 0.005])
def test_an_arm_stands_whatever_the_noise_of_its_encoders(arm, noise_deg):
    one = arm(lag_s=0.012, noise_deg=noise_deg)
    one.connect()
    one.move((20.0, *START[1:]))
    one.cycle(60)
    assert moving(one)
    one.cycle(400)
    assert not moving(one)
    one.shared.send(RsiCommand(CLOSE))
    one.cycle(40)
    assert one.ended


def test_an_arm_that_hums_more_where_it_arrived_is_seen_to_stand(arm):
    one = arm(lag_s=0.012, noise_deg=1e-4)
    one.connect()
    one.move((20.0, *START[1:]))
    one.cycle(60)
    one.noise = 0.005
    one.cycle(400)
    assert not moving(one)


def test_the_bench_is_absolute():
    one = Bench()
    try:
        assert one.sent[-1] == (0.0,) * 6
    finally:
        one.shared.close()
