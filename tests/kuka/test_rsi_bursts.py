"""Telegrams that were kept somewhere and then come all at once: answers to them are too late, which not every controller's Delay shows."""

import re

import numpy as np
import pytest
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import MOVE, RsiCommand, Shared
from rsi_bench import ACCELERATION, JERK, LIMITS, SOURCE, SPEED, START, T

FAR = (100.0, *START[1:])


class Peer:
    """``counts``: its Delay says which answers it did not use; else it is always zero. Its telegrams are kept for ``stall_s`` now and then, and come in a burst whose answers it has
    stopped waiting for. ``path``: set points that it had, one a cycle."""

    def __init__(self, counts=False):
        self.counts, self.delay = counts, 0
        self.shared = Shared.create()
        self.session = RsiSession(self.shared, RsiOptions(limits_deg=LIMITS).settings())
        self.ipoc, self.behind_s, self.q, self.path = 1000, 0.0, np.array(START), []

    def cycle(self):
        self.ipoc += 4
        self.behind_s = max(0.0, self.behind_s - T)
        arrives = self.ipoc * 1e-3 + self.behind_s
        axes = " ".join(f'A{i + 1}="{v:.6f}"' for i, v in enumerate(self.q))
        telegram = f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="{self.delay}"/><IPOC>{self.ipoc}</IPOC></Rob>'.encode()
        answer = self.session.reply(telegram, SOURCE, arrives)
        self.session.digest(arrives)
        if answer is not None and self.behind_s < 0.9 * T:
            if correction := re.findall(rb'A\d="([^"]+)"', answer):  # else it is to keep what it has
                self.q = START + np.array([float(v) for v in correction])
        else:
            self.delay += self.counts
        self.path.append(self.q)
        return answer

    def move(self, target):
        self.shared.send(RsiCommand(MOVE, target, (SPEED,) * 6, (ACCELERATION,) * 6, (JERK,) * 6, 0.01, 0.1))


@pytest.fixture(params=[False, True], ids=["no Delay", "Delay"])
def peer(request):
    one = Peer(request.param)
    while not one.session.connected:
        one.cycle()
    one.move(FAR)
    yield one
    one.shared.close()


@pytest.mark.parametrize("stall_s", [0.012, 0.032, 0.06])
def test_set_points_do_not_run_ahead_of_a_controller_whose_telegrams_came_in_a_burst(peer, stall_s):
    for stall_at in (60, 110, 160):
        while len(peer.path) < stall_at + 60:
            peer.cycle()
        peer.behind_s = stall_s + T
        used, before = len(peer.path), peer.path[-1]
        while peer.behind_s > 1.5 * T:
            peer.cycle()
        np.testing.assert_array_equal(peer.path[-1], before)
        for _ in range(60):
            peer.cycle()
        path = np.array(peer.path[used - 1 :])
        assert np.abs(np.diff(path, axis=0)).max() <= SPEED * T * 1.001 + 2e-6
        assert np.abs(np.diff(path[1:], 2, axis=0)).max() <= ACCELERATION * T**2 * 1.001 + 4e-6
    for _ in range(900):
        peer.cycle()
    assert peer.shared.fault() is None
    np.testing.assert_allclose(peer.path[-1], FAR, atol=1e-6)


def test_a_peer_that_waits_for_its_answers_and_is_faster_than_its_clock_gets_every_one():
    """A simulator in lock-step: it sends as soon as it has its answer, and sometimes thinks in between."""
    one = Peer()
    try:
        clock = 0.0
        for cycle in range(400):
            one.ipoc += 4
            clock += 0.05 if cycle % 40 == 0 else 2e-4
            axes = " ".join(f'A{i + 1}="{v:.6f}"' for i, v in enumerate(one.q))
            answer = one.session.reply(
                f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="0"/><IPOC>{one.ipoc}</IPOC></Rob>'.encode(), SOURCE, clock
            )
            one.session.digest(clock)
            assert answer is not None
            one.q = START + np.array([float(v) for v in re.findall(rb'A\d="([^"]+)"', answer)])
            if cycle == 100:
                one.move(FAR)
    finally:
        one.shared.close()
