"""The answers of a session, without sockets: whatever happens, the commanded path stays within its limits."""

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mbcacq_kuka.rsi.motion import RsiMotion
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import MOVE, STOP, RsiCommand, Shared

START = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
LIMITS = ((-180.0, 180.0), (-150.0, 10.0), (-120.0, 160.0), (-350.0, 350.0), (-125.0, 125.0), (-350.0, 350.0))
SPEED, ACCELERATION, JERK, T = 100.0, 400.0, 4000.0, 0.004
SOURCE = ("127.0.0.1", 50007)


class Bench:
    """A session with an arm that follows its last answer at once."""

    def __init__(self, **options):
        self.shared = Shared.create()
        self.session = RsiSession(self.shared, RsiOptions(limits_deg=LIMITS, **options).settings())
        self.ipoc, self.delay, self.sent = 1000, 0, []
        self.q = START
        for _ in range(8):
            self.cycle()

    def telegram(self, ipoc=None):
        axes = " ".join(f'A{i + 1}="{v:.6f}"' for i, v in enumerate(self.q))
        return f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="{self.delay}"/><IPOC>{self.ipoc if ipoc is None else ipoc}</IPOC></Rob>'.encode()

    def cycle(self, data=None, source=SOURCE, step=4, accepted=True):
        """The correction answered, or None."""
        self.ipoc += step
        answer = self.session.answer(self.telegram() if data is None else data, source, self.ipoc * 1e-3)
        if answer is None:
            return None
        correction = tuple(float(v) for v in re.findall(rb'A\d="([^"]+)"', answer))
        if accepted:
            self.sent.append(correction)
            self.q = tuple(s + c for s, c in zip(START, correction, strict=True))
        else:
            self.delay += 1
        return correction

    def move(self, target):
        self.shared.send(RsiCommand(MOVE, target, (SPEED,) * 6, (ACCELERATION,) * 6, (JERK,) * 6, 0.01, 0.1))

    def stop(self):
        self.shared.send(RsiCommand(STOP))


@pytest.fixture
def bench():
    made = []

    def make(**options):
        made.append(Bench(**options))
        return made[-1]

    yield make
    for one in made:
        one.shared.close()


def targets():
    return st.tuples(*(st.floats(low, high) for low, high in LIMITS))


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(st.one_of(targets(), st.none()), st.integers(1, 150)), min_size=1, max_size=6))
def test_no_sequence_of_commands_breaks_a_limit(bench, plan):
    one = bench()
    for target, cycles in plan:
        one.stop() if target is None else one.move(target)
        for _ in range(cycles):
            one.cycle()
    fault = one.shared.fault()
    assert fault is None or fault["kind"] == "refused"
    path = np.array(one.sent)
    for order, limit in ((1, SPEED), (2, ACCELERATION), (3, JERK)):
        assert np.abs(np.diff(path, order, axis=0)).max() <= limit * T**order * 1.001 + 2**order * 1e-6
    angles = path + START
    assert (angles >= np.array(LIMITS)[:, 0] - 1e-5).all()
    assert (angles <= np.array(LIMITS)[:, 1] + 1e-5).all()


EVENTS = st.sampled_from(["good"] * 12 + ["lost", "rejected", "repeated", "late", "malformed", "foreign", "jump", "blind"])


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(EVENTS, min_size=20, max_size=200), targets())
def test_no_disturbance_makes_the_arm_jump(bench, events, target):
    """The controller uses accepted answers one after the other: two of them never differ by more than one cycle's motion."""
    one = bench()
    one.move(target)
    for event in events:
        if event == "good":
            one.cycle()
        elif event == "lost":
            one.ipoc += 4
        elif event == "rejected":
            one.cycle(accepted=False)
        elif event == "repeated":
            one.cycle(step=0)
        elif event == "late":
            one.ipoc += 4
            assert one.session.answer(one.telegram(), SOURCE, one.ipoc * 1e-3, in_time=False) is not None
            one.delay += 1
        elif event == "malformed":
            assert one.cycle(data=b'<Rob Type="KUKA"><AIPos A1="1') is None
        elif event == "foreign":
            assert one.cycle(source=("127.0.0.1", 1)) is None
        elif event == "jump":
            assert one.cycle(data=one.telegram(one.ipoc + 401)) is None
        elif event == "blind":
            assert one.cycle(data=b'<Rob Type="KUKA"><Delay D="0"/><IPOC>%d</IPOC></Rob>' % (one.ipoc + 4)) is None
    fault = one.shared.fault()
    assert (fault is None) == (not {"malformed", "foreign", "jump", "blind"} & set(events))
    assert np.abs(np.diff(np.array(one.sent), axis=0)).max() <= SPEED * T * 1.001 + 2e-6
    if fault is not None:
        for _ in range(150):
            one.cycle()
        assert one.cycle() == one.cycle() is not None


def test_a_distance_at_which_two_profiles_of_the_planner_meet():
    """7.200000000000005 deg with these limits is a case ruckig 0.19 cannot solve."""
    motion = RsiMotion((7.200000000000005, *START[1:]), T, LIMITS)
    motion.move(RsiCommand(MOVE, START, (90.0,) * 6, (360.0,) * 6, (3600.0,) * 6))
    path = [motion.position]
    while motion.moving:
        path.append(motion.step())
    assert path[-1] == pytest.approx(START)
    assert np.abs(np.diff(path, 3, axis=0)).max() <= 3600.0 * T**3 * 1.001 + 1e-9


def test_a_discarded_answer_is_given_again_and_a_lost_telegram_costs_one_cycle(bench):
    one = bench()
    one.move((100.0, *START[1:]))
    for _ in range(100):
        one.cycle()
    step = one.sent[-1][0] - one.sent[-2][0]
    assert step == pytest.approx(SPEED * T, abs=2e-6)
    discarded = one.cycle(accepted=False)
    assert one.cycle() == discarded
    one.ipoc, one.delay = one.ipoc + 4, one.delay + 1  # a telegram that never came; the controller missed its answer
    assert one.cycle()[0] == pytest.approx(discarded[0] + step, abs=2e-6)


def test_a_restarted_program_is_never_answered(bench):
    one = bench()
    one.move((20.0, *START[1:]))
    for _ in range(100):
        one.cycle()
    one.ipoc, one.q = 50, START
    assert all(one.cycle() is None for _ in range(20))
    assert one.shared.fault()["kind"] == "protocol"


def test_silence_is_final(bench):
    one = bench()
    one.session.idle(one.ipoc * 1e-3 + 0.9)
    assert one.shared.fault() is None
    one.session.idle(one.ipoc * 1e-3 + 1.1)
    assert one.shared.fault()["kind"] == "silence"
    assert one.cycle() is None


def test_the_first_nearly_empty_telegram_of_old_controllers_is_answered_with_its_ipoc():
    shared = Shared.create()
    try:
        session = RsiSession(shared, RsiOptions(limits_deg=LIMITS).settings())
        answer = session.answer(b'<Rob Type="KUKA"><IPOC>77</IPOC></Rob>', SOURCE, 0.0)
        assert answer.endswith(b'A6="0.000000"/><IPOC>77</IPOC></Sen>')
        assert shared.fault() is None
    finally:
        shared.close()


def test_the_arm_may_lag_but_must_follow(bench):
    """Half a second behind is too much, a quarter of a second is a lag."""
    for cycles, fine in ((60, True), (125, False)):
        one = bench()
        one.move((100.0, *START[1:]))
        past = [START] * cycles
        for _ in range(400):
            one.cycle()
            past.append(one.q)
            one.q = past.pop(0)
        fault = one.shared.fault()
        assert (fault is None) is fine
        assert fine or fault["kind"] == "follow"
