"""Networks as they are: repeated, old, missing and late datagrams, other senders. One session, without sockets."""

import numpy as np
import pytest
from mbcacq_kuka.rsi.lateness import Lateness
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.sequence import NEXT, OLD, REPEATED, STRANGE, Counts, Sequence
from rsi_bench import ACCELERATION, LIMITS, SOURCE, START, Bench, T

from mbcacq.devices import ConfigError, parse_options

FAR = (100.0, *START[1:])


@pytest.fixture
def moving():
    """A bench whose arm moves at full speed."""
    one = Bench()
    one.move(FAR)
    for _ in range(100):
        one.cycle()
    yield one
    one.shared.close()


def counts(one):
    seen = one.session.counts
    return seen.lost, seen.repeated, seen.old, seen.foreign


def test_a_repeated_telegram_gets_no_second_answer(moving):
    moving.cycle()
    assert moving.cycle(step=0) is None
    assert moving.cycle() is not None
    assert counts(moving) == (0, 1, 0, 0)
    assert moving.shared.fault() is None


def test_a_peer_that_waits_for_its_answer_gets_the_same_again(moving):
    answer = moving.cycle()
    telegram = moving.telegram()
    again = moving.session.reply(telegram, SOURCE, moving.ipoc * 1e-3 + 0.02)
    moving.session.digest(moving.ipoc * 1e-3 + 0.02)
    assert again is not None
    assert b'A1="%.6f"' % answer[0] in again


def test_two_telegrams_that_change_places_cost_one_answer(moving):
    first = moving.telegram(moving.ipoc + 4)
    moving.ipoc, moving.delay = moving.ipoc + 4, 1  # the later one arrives first; the controller has missed the answer to the first
    before = moving.sent[-1]
    assert moving.cycle() == before  # which the controller held
    assert moving.reply(first) is None
    assert moving.cycle() is not None
    assert counts(moving) == (1, 0, 1, 0)
    assert moving.shared.fault() is None


def test_after_an_answer_that_was_rejected_before_a_stall_the_controller_gets_what_it_holds(moving):
    """The telegram that tells of it cannot be answered in time itself."""
    held = moving.sent[-1]
    moving.cycle(accepted=False)
    moving.ipoc += 4
    moving.reply(moving.telegram(), in_time=False)
    moving.delay += 1
    assert moving.cycle() == held


def test_other_senders_are_counted_and_dropped(moving):
    for data in (b"x", b"", moving.telegram(), b"<Rob"):
        assert moving.reply(data, ("192.0.2.9", 49152)) is None
    assert counts(moving) == (0, 0, 0, 4)
    assert moving.cycle() is not None
    assert moving.shared.fault() is None


def test_what_the_network_did_stands_in_the_recording(moving):
    moving.cycle(step=0)
    moving.ipoc += 8
    moving.cycle()
    ring = np.frombuffer(moving.shared.ring).reshape(moving.shared.capacity, moving.shared.width)
    row = ring[(moving.shared.head - 1) % moving.shared.capacity].copy()
    del ring
    assert row[4:8].tolist() == [2.0, 1.0, 0.0, 0.0]


def test_a_gap_that_the_controller_rides_out_is_ridden_out_from_rest(moving):
    moving.ipoc, moving.delay = moving.ipoc + 74 * 4, moving.delay + 74  # 0.3 s
    before = len(moving.sent)
    for _ in range(400):
        moving.cycle()
    assert moving.shared.fault() is None
    path = np.array(moving.sent[before - 1 :])[:, 0]
    assert path[-1] == pytest.approx(FAR[0], abs=1e-6)
    first = np.diff(path[np.flatnonzero(np.diff(path))[0] :])[:10] / T
    assert np.all(first <= ACCELERATION * T * np.arange(1, 11) + 1e-3)  # the arm stood: it must not be asked for full speed at once


@pytest.mark.parametrize("cycles", [1, 2, 5])
def test_after_a_short_gap_the_motion_goes_on_from_rest(moving, cycles):
    moving.ipoc, moving.delay = moving.ipoc + cycles * 4, moving.delay + cycles
    held = moving.sent[-1][0]
    steps = np.diff([held, *(moving.cycle()[0] for _ in range(60))])
    assert np.diff([0.0, *steps]).max() <= ACCELERATION * T**2 * 1.001 + 4e-6
    assert steps[-1] > 0.0


def test_after_a_longer_gap_the_session_is_another_one(moving):
    moving.ipoc += 80 * 4
    assert moving.cycle() is None
    assert moving.shared.fault()["kind"] == "restart"
    assert all(moving.cycle() is None for _ in range(20))


def test_a_program_that_was_restarted_within_a_gap_is_not_answered():
    one = Bench()
    plain = one.telegram
    try:
        one.session = None  # a session whose telegrams also carry the set point without correction
        planned = [START]

        def telegram(ipoc=None):
            axes = " ".join(f'A{i + 1}="{v:.6f}"' for i, v in enumerate(planned[0]))
            return plain(ipoc).replace(b"<Delay", f"<ASPos {axes}/><Delay".encode())

        from mbcacq_kuka.rsi.options import RsiOptions
        from mbcacq_kuka.rsi.session import RsiSession

        one.telegram, one.session = telegram, RsiSession(one.shared, RsiOptions(limits_deg=LIMITS).settings())
        one.q = START
        while not one.session.connected:
            one.cycle()
        one.move(FAR)
        for _ in range(80):
            one.cycle()
        one.ipoc, planned[0] = one.ipoc + 40 * 4, one.q
        assert one.cycle() is None
        assert one.shared.fault()["kind"] == "restart"
    finally:
        one.shared.close()


def test_one_late_answer_in_twelve_seconds_never_adds_up():
    lateness = Lateness(0.0, 90, 1.0)
    for k in range(1, 10_000):
        lateness.rise(float(k), 12.0 * k)
        assert not lateness.too_many
    for k in range(91):
        lateness.rise(10_000.0 + k, 120_000.0 + 0.004 * k)
    assert lateness.too_many


def test_without_a_window_the_whole_session_counts():
    lateness = Lateness(5.0, 2, 0.0)
    for k, expected in ((6, False), (7, False), (8, True)):
        lateness.rise(float(k), 1000.0 * k)
        assert lateness.too_many is expected


def test_a_count_that_falls_back_is_no_lateness():
    lateness = Lateness(0.0, 3, 1.0)
    rises = [lateness.rise(delay, 0.004 * k) for k, delay in enumerate([1.0, 0.0, 2.0, 0.0, 1.0])]
    assert rises == [1.0, 0.0, 2.0, 0.0, 1.0]
    assert lateness.too_many


@pytest.mark.parametrize(
    ("ipoc", "kind", "steps"),
    [
        (1004, NEXT, 1),
        (1300, NEXT, 75),
        (1304, STRANGE, 0),
        (1000, REPEATED, 0),
        (996, OLD, 0),
        (700, OLD, 0),
        (696, STRANGE, 0),
        (1001, STRANGE, 0),
        (999, STRANGE, 0),
    ],
)
def test_a_telegram_is_known_by_its_ipoc(ipoc, kind, steps):
    assert Sequence(1000, 4, 75, Counts()).take(ipoc) == (kind, steps)


@pytest.mark.parametrize("bind", ["0.0.0.0", "172.31.1.100"])
def test_a_socket_beyond_this_computer_needs_the_controllers_address(bind):
    with pytest.raises(ConfigError, match="controller_ip is missing"):
        parse_options(RsiOptions, "the arm", {"limits_deg": LIMITS, "bind": bind})
    assert parse_options(RsiOptions, "the arm", {"limits_deg": LIMITS, "bind": bind, "controller_ip": "172.31.1.147"}).bind == bind
    assert parse_options(RsiOptions, "the arm", {"limits_deg": LIMITS, "bind": "127.0.0.2"}).controller_ip == ""


def test_telegrams_of_another_computer_do_not_begin_a_session():
    one = Bench()
    try:
        from mbcacq_kuka.rsi.options import RsiOptions
        from mbcacq_kuka.rsi.session import RsiSession

        one.session = RsiSession(one.shared, RsiOptions(limits_deg=LIMITS, bind="172.31.1.100", controller_ip="172.31.1.147").settings())
        for _ in range(30):
            assert one.cycle(source=("172.31.1.9", 49152)) is None
        assert one.shared.fault() is None
        for _ in range(10):
            assert one.cycle(source=("172.31.1.147", 49152)) is not None
        assert one.session.counts.foreign == 30
    finally:
        one.shared.close()
