"""No set point leaves the RSI process that an axis could not follow, whoever asks for it."""

from contextlib import suppress

import numpy as np
import pytest
from mbcacq_fakes.protocols.krc.session import ACCELERATION as ACCELERATION_FAULT
from mbcacq_fakes.protocols.krc.session import FakeRsiSession
from mbcacq_fakes.protocols.krc.settings import KrcSettings
from mbcacq_fakes.protocols.krc.wire import RsiAnswer
from mbcacq_kuka.rsi.motion import MotionRefused, RsiMotion
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.shared import MOVE, RsiCommand
from mbcacq_kuka.rsi.step_limits import StepLimits
from rsi_bench import ACCELERATION, JERK, LIMITS, SPEED, START, Bench, T

FAR = (100.0, *START[1:])
LIMITED = {"speed_deg_s": (SPEED,) * 6, "acceleration_deg_s2": (ACCELERATION,) * 6, "jerk_deg_s3": (JERK,) * 6}


@pytest.fixture
def one():
    made = Bench(**LIMITED)
    yield made
    made.shared.close()


def command(target=FAR, speed=SPEED, acceleration=ACCELERATION, jerk=JERK):
    return RsiCommand(MOVE, target, (speed,) * 6, (acceleration,) * 6, (jerk,) * 6, 0.01, 0.1)


def steps(one, cycles=400):
    """Speed, acceleration and jerk of A1 over what the controller used: deg/s, deg/s^2, deg/s^3."""
    for _ in range(cycles):
        one.cycle()
    path = np.array(one.sent)[:, 0]
    return [np.abs(np.diff(path, order)).max() / T**order for order in (1, 2, 3)]


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_motions_within_the_limits_are_never_refused(share):
    rng = np.random.default_rng(2)
    dynamics = [[share * v for v in limit] for limit in RsiOptions(limits_deg=LIMITS, **LIMITED).dynamics]
    limits, motion = StepLimits(START, LIMITS, tuple(dynamics), T), RsiMotion(START, T, LIMITS)
    for _ in range(40):
        with suppress(MotionRefused):  # it would swing beyond the joint limits; then the present motion goes on
            motion.move(command(tuple(START + rng.uniform(-30, 30, 6)), share * SPEED, share * ACCELERATION, share * JERK))
        for _ in range(int(rng.integers(1, 300))):  # most are turned round on the way
            position = motion.step()
            assert limits.refusal(position) == ""
            limits.take(position)


@pytest.mark.parametrize(
    ("beyond", "words"),
    [
        ({"speed": 2 * SPEED}, "A1 would turn at 200 °/s, its limit is 100; nothing was moved"),
        ({"acceleration": 20 * ACCELERATION}, "A1 would accelerate with 8000 °/s², its limit is 400; nothing was moved"),
        ({"jerk": np.nan}, "A1 would jerk with nan °/s³"),
    ],
)
def test_a_command_beyond_the_limits_of_the_axes_moves_nothing(one, beyond, words):
    one.shared.send(command(**beyond))
    for _ in range(10):
        one.cycle()
    assert one.shared.fault()["kind"] == "refused"
    assert words in one.shared.fault()["text"]
    assert one.sent[-1] == one.sent[0]


def test_a_planned_motion_that_is_too_steep_is_replaced_by_braking(one, monkeypatch):
    """As a fault in the planning of motions would make it."""
    one.move(FAR)
    for _ in range(20):
        one.cycle()
    monkeypatch.setattr(StepLimits, "too_fast", lambda self, command: "")
    one.shared.send(command(jerk=20 * JERK))
    speed, acceleration, jerk = steps(one)
    assert one.shared.fault()["kind"] == "refused"
    rounding = 1e-6  # of the answer, deg
    assert speed <= 1.002 * SPEED + 2 * rounding / T
    assert acceleration <= 1.002 * ACCELERATION + 4 * rounding / T**2
    assert jerk <= 1.002 * JERK + 8 * rounding / T**3
    assert one.sent[-1] == one.sent[-100]  # at rest
    assert one.sent[-1][0] < 99.0


@pytest.mark.parametrize("where", [FAR, (np.nan,) * 6, (1.0, *START[1:])])
def test_a_set_point_that_jumps_is_not_sent(one, monkeypatch, where):
    """As a fault in the planning of motions would make it."""
    one.move(FAR)
    for _ in range(60):
        one.cycle()
    before = one.sent[-1][0]
    monkeypatch.setattr(RsiMotion, "step", lambda self: where)
    for _ in range(20):
        one.cycle()
    assert one.shared.fault()["kind"] == "refused"
    assert "that set point was not sent" in one.shared.fault()["text"]
    assert one.sent[-1][0] - before < 2 * SPEED * T  # the controller has nothing new to follow
    assert one.cycle() is None


def test_a_set_point_beyond_the_joint_limits_is_refused_and_one_on_the_way_back_is_not():
    limits = StepLimits((181.0, *START[1:]), LIMITS, RsiOptions(limits_deg=LIMITS).dynamics, T)
    assert "A1 would go to 181.100°, outside its limits -180..180°" in limits.refusal((181.1, *START[1:]))
    assert limits.refusal((180.99, *START[1:])) == ""


def test_axes_without_stated_limits_are_taken_for_fast_ones():
    speed, acceleration, jerk = RsiOptions(limits_deg=LIMITS).dynamics
    assert (speed[0], acceleration[0], jerk[0]) == (800.0, 16_000.0, 3.2e6)
    assert RsiOptions(limits_deg=LIMITS, speed_deg_s=(100.0,) * 6).dynamics[1] == [2000.0] * 6


def asked(session, ipoc, degrees):
    """One cycle of a controller that is sent this correction of A1."""
    session.accept(RsiAnswer(str(ipoc), "ImFree", {"A1": degrees}, False), ipoc)
    session.apply(None, False)
    return session.ended


@pytest.mark.parametrize(("change", "ended"), [(0.9, None), (1.2, ACCELERATION_FAULT)])
def test_the_fake_controller_stops_at_a_command_that_is_too_steep(change, ended):
    session = FakeRsiSession(KrcSettings(acceleration_deg_s2=(1000.0,) * 6), START)
    path = np.cumsum(np.cumsum([0.0, 0.0, 0.0, *[change * 1000.0 * T**2] * 5]))
    found = [asked(session, k, degrees) for k, degrees in enumerate(path)]
    assert found[2] is None
    assert found[-1] == ended


def test_the_fake_controller_forgives_a_step_after_a_missing_answer():
    session = FakeRsiSession(KrcSettings(acceleration_deg_s2=(1000.0,) * 6), START)
    for k in range(5):
        asked(session, k, 0.0)
    session.miss(False)
    assert asked(session, 6, 0.5) is None
