"""The answers of a session, without sockets: whatever happens, the commanded path stays within its limits."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mbcacq_kuka.rsi.motion import RsiMotion
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import MOVE, RsiCommand, Shared
from rsi_bench import ACCELERATION, JERK, LIMITS, SOURCE, SPEED, START, Bench, T


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


def lost(one):
    one.ipoc += 4


def answered_late(one):
    one.ipoc += 4
    assert one.reply(one.telegram(), in_time=False) is not None
    one.delay += 1


def unanswered(*args, **given):
    def event(one):
        assert one.cycle(*[a(one) for a in args], **given) is None

    return event


HARMLESS = {
    "good": lambda one: one.cycle(),
    "lost": lost,
    "rejected": lambda one: one.cycle(accepted=False),
    "counted though it was used": lambda one: one.cycle(counted=True),
    "rejected without a count": lambda one: one.cycle(accepted=False, counted=False),
    "late": answered_late,
    "repeated": lambda one: one.cycle(one.telegram(one.heard), step=0),
    "old": unanswered(lambda one: one.telegram(one.heard - 8), step=0),
    "foreign": unanswered(step=0, source=("127.0.0.1", 1)),
    "stray byte": unanswered(lambda one: b"x", step=0, source=("192.0.2.1", 1)),
}
HARMFUL = {
    "malformed": unanswered(lambda one: b'<Rob Type="KUKA"><AIPos A1="1'),
    "another session": unanswered(lambda one: one.telegram(one.ipoc + 401)),
    "blind": unanswered(lambda one: b'<Rob Type="KUKA"><Delay D="0"/><IPOC>%d</IPOC></Rob>' % (one.ipoc + 8)),
}
EVENTS = st.sampled_from(["good"] * 12 + [*HARMLESS, *HARMFUL])


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(EVENTS, min_size=20, max_size=200), targets())
def test_no_disturbance_makes_the_arm_jump(bench, events, target):
    """Two answers that the controller uses one after the other never differ by more than one cycle's motion."""
    one = bench(late_limit=1000)
    one.move(target)
    for event in events:
        (HARMLESS | HARMFUL)[event](one)
        if event in HARMFUL:
            break
    fault = one.shared.fault()
    assert (fault is None) == (not set(HARMFUL) & set(events))
    assert np.abs(np.diff(np.array(one.sent), axis=0)).max() <= SPEED * T * 1.001 + 2e-6
    if fault is not None and fault["kind"] != "restart":
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


@pytest.mark.parametrize("speed", [1e-3, 1e-5, 1e-9])
def test_a_motion_that_the_planner_cannot_time_is_refused_and_the_one_before_stands(bench, speed):
    """Ruckig gives a result that its Python bindings do not know, which is a ValueError there."""
    one = bench()
    slow = (speed,) * 6, (speed / 0.3,) * 6, (speed / 0.03,) * 6
    one.shared.send(RsiCommand(MOVE, (90.0, *START[1:]), *slow, 0.01, 0.1))
    for _ in range(120):
        assert one.cycle() == (0.0,) * 6
    assert one.shared.fault()["kind"] == "refused"
    assert "no motion to this target exists within the limits" in one.shared.fault()["text"]


def test_a_discarded_answer_is_given_again_and_a_lost_telegram_costs_one_cycle(bench):
    one = bench()
    one.move((100.0, *START[1:]))
    for _ in range(100):
        one.cycle()
    step = one.sent[-1][0] - one.sent[-2][0]
    assert step == pytest.approx(SPEED * T, abs=2e-6)
    held = one.sent[-1]
    one.cycle(accepted=False)
    assert one.cycle() == held
    for _ in range(100):
        one.cycle()
    last = one.sent[-1]
    one.ipoc, one.delay = one.ipoc + 4, one.delay + 1  # a telegram that never came; the controller missed its answer
    assert one.cycle() == last


@pytest.mark.parametrize("counts_missing", [True, False], ids=["Delay counts missing answers", "Delay counts late ones alone"])
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.data())
def test_no_set_point_accelerates_beyond_the_limit_on_the_path_that_the_controller_saw(bench, counts_missing, data):
    """It holds its last set point where an answer is missing. What it does then is its own; every other set point that it is given is
    judged, also where it counts an answer that it has taken."""
    kinds = ["lost", "rejected", "counted though it was used", "late", "stop", "turn"]
    target, events = data.draw(targets()), data.draw(st.lists(st.sampled_from(["good"] * 12 + kinds), min_size=50, max_size=300))
    one = bench(late_limit=10_000)
    one.move(target)
    path, given = [one.sent[-1]] * 3, []
    for event in events:
        used = len(one.sent)
        if event in ("stop", "turn"):
            one.stop() if event == "stop" else one.move(START)
        else:
            HARMLESS[event](one)
            one.delay += event == "lost" and counts_missing
            path.append(one.sent[-1])
            given.append(len(one.sent) > used and path[-1] != path[-2])
    new = np.array(given)
    assert np.abs(np.diff(path, axis=0)).max() <= SPEED * T * 1.001 + 2e-6
    acceleration = np.abs(np.diff(path, 2, axis=0)).max(axis=1)[-len(given) :]
    assert acceleration[new].max(initial=0.0) <= ACCELERATION * T**2 * 1.001 + 4e-6


@pytest.mark.parametrize("moving", [5, 14, 60])
def test_a_lost_telegram_behind_a_discarded_answer_starts_no_jump(bench, moving):
    """Both are counted by Delay: the arm stood for two cycles, and goes on from rest."""
    one = bench()
    one.move((100.0, *START[1:]))
    for _ in range(moving):
        one.cycle()
    one.cycle(accepted=False)
    one.ipoc, one.delay = one.ipoc + 4, one.delay + 1
    path = [one.sent[-1]] * 3
    for _ in range(40):
        one.cycle()
        path.append(one.sent[-1])
    assert np.abs(np.diff(path, 2, axis=0)).max() <= ACCELERATION * T**2 * 1.001 + 4e-6
    assert path[-1] != path[0]


@pytest.mark.parametrize("taken", [True, False], ids=["taken", "not taken"])
@pytest.mark.parametrize("lag_s", [0.012, 0.03, 0.06])
def test_an_arm_that_lags_is_not_taken_for_one_that_stands(bench, lag_s, taken):
    """Seen too early it is before both set points, or at the wrong one: the path would step back, or forth by two."""
    for moving in (4, 6, 8, 10, 14, 20):
        one = bench(lag_s=lag_s)
        one.move((100.0, *START[1:]))
        for _ in range(moving):
            one.cycle()
        one.cycle(accepted=taken, counted=True)
        before = len(one.sent)
        for _ in range(200):
            one.cycle()
        after = np.array(one.sent)[before - 1 :, 0]
        assert one.shared.fault() is None
        assert after[-1] > after[0]
        assert (np.diff(after) >= 0.0).all()
        assert np.diff(after, 2, prepend=after[0]).max() <= ACCELERATION * T**2 * 1.001 + 4e-6


@pytest.mark.parametrize(("moving", "beside_deg", "fault"), [(8, 0.001, None), (60, 0.001, None), (60, 0.2, "follow")])
def test_an_arm_that_stands_beside_both_set_points(bench, moving, beside_deg, fault):
    """A controller at rest is a little off. Is it by more than limits allow, something holds the arm, and no set point moves it on."""
    one = bench()
    one.move((100.0, *START[1:]))
    for _ in range(moving):
        one.cycle()
    one.beside_deg = beside_deg
    held = one.cycle(counted=True)
    for _ in range(600):
        one.cycle()
    if fault is None:
        assert one.shared.fault() is None
        assert one.sent[-1][0] > held[0] + 1.0
    else:
        assert one.shared.fault()["kind"] == fault
        assert "stands at neither" in one.shared.fault()["text"]
        assert one.sent[-1] == held


def test_a_restarted_program_is_never_answered(bench):
    one = bench()
    one.move((20.0, *START[1:]))
    for _ in range(100):
        one.cycle()
    one.ipoc, one.q = 50, START
    assert all(one.cycle() is None for _ in range(20))
    assert one.shared.fault()["kind"] == "restart"


def test_silence_is_final(bench):
    one = bench()
    one.session.idle(one.ipoc * 1e-3 + 0.9)
    assert one.shared.fault() is None
    one.session.idle(one.ipoc * 1e-3 + 1.1)
    assert one.shared.fault()["kind"] == "silence"
    assert one.cycle() is None


def test_silence_after_discarded_answers_says_so(bench):
    """A controller that counts in total stops at its own limit before a window of the last second fills."""
    one = bench(late_limit=90)
    for k in range(60):
        (answered_late if k % 10 == 0 else Bench.cycle)(one)
    one.session.idle(one.ipoc * 1e-3 + 1.1)
    fault = one.shared.fault()
    assert fault["kind"] == "silence"
    assert "discarded 6 answers of this session as late or invalid" in fault["text"]


def test_the_first_nearly_empty_telegram_of_old_controllers_is_answered_with_its_ipoc():
    shared = Shared.create()
    try:
        session = RsiSession(shared, RsiOptions(limits_deg=LIMITS).settings())
        answer = session.reply(b'<Rob Type="KUKA"><IPOC>77</IPOC></Rob>', SOURCE, 0.0)
        assert answer.endswith(b'A6="0.000000"/><IPOC>77</IPOC></Sen>')
        assert shared.fault() is None
    finally:
        shared.close()


@pytest.mark.parametrize(("cycles", "fine"), [(20, True), (80, False)])
def test_the_arm_may_lag_but_must_follow(bench, cycles, fine):
    """A third of a second behind is too much, a twelfth is a lag."""
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
