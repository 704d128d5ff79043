"""Shortly before a telegram is due the way of its answer is gone once, to have it in the processor's caches. Nothing may come of that."""

import random
import socket
import threading

import pytest
from mbcacq_kuka.rsi.cycle import run
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.punctuality import Punctuality
from mbcacq_kuka.rsi.realtime import open_socket
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import Shared
from rsi_bench import LIMITS, START, Bench


def played(rehearsals):
    """Answers, and the shared memory with ring, fault and counts, of a session with motions, a stop, rejected answers and gaps; before each
    telegram as many rehearsals as ``rehearsals()`` says."""
    one = Bench(digital_outputs=(3,))
    chance, answers, reply = random.Random(5), [], one.reply

    def after_rehearsing(data, *given, **named):
        for k in range(rehearsals()):
            one.session.rehearse(one.ipoc * 1e-3 - 1e-4 * k)
        return reply(data, *given, **named)

    one.reply = after_rehearsing
    try:
        for k in range(500):
            if k in (20, 150, 300):
                one.move((10.0 + k / 20.0, *START[1:]))
            if k == 220:
                one.stop()
            if k == 340:
                one.shared.outputs = 1
            kind = chance.random()
            answers.append(one.cycle(step=4 if kind < 0.97 else 12, accepted=not 0.95 < kind < 0.97))
            if k == 400:
                assert one.cycle(data=b"<Rob", step=0) is None
        return answers, bytes(one.shared._buffer[: 1 << 20])
    finally:
        one.shared.close()


def test_answers_and_ring_are_the_same_with_rehearsals_and_without():
    count = random.Random(1)
    never, often = played(lambda: 0), played(lambda: count.randrange(4))
    assert len(set(never[0])) > 100  # it moved
    assert often == never


def test_a_telegram_that_was_late_does_not_delay_the_next_rehearsal():
    clock = Punctuality(0.004)
    for now in (1.0, 1.004, 1.0085, 1.012):  # the third one is late by 0.5 ms
        clock.take(now, 1)
        assert clock.due == pytest.approx(1.004 + 0.004 * round((now - 1.0) / 0.004), abs=1e-9)


class Controller:
    """Telegrams of an arm that stands, over a socket, to a cycle at work in a thread of this process. ``answered`` sends the next one."""

    def __init__(self):
        self.shared = Shared.create()
        self.session = RsiSession(self.shared, RsiOptions(limits_deg=LIMITS).settings())
        self.here, self.there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), open_socket("127.0.0.1", 0, 0.02)
        self.here.settimeout(20.0)
        self.here.connect(self.there.getsockname())
        self.ipoc, self.gone = 1000, threading.Event()
        self._cycle = threading.Thread(target=run, args=(self.there, self.session, self.gone))

    def __enter__(self):
        self._cycle.start()
        return self

    def __exit__(self, *_):
        self.gone.set()
        self._cycle.join(20.0)
        self.here.close()
        self.there.close()
        self.shared.close()

    def send(self):
        self.ipoc += 4
        axes = " ".join(f'A{i + 1}="{v:.6f}"' for i, v in enumerate(START))
        self.here.send(f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="0"/><IPOC>{self.ipoc}</IPOC></Rob>'.encode())

    def is_answered(self):
        return b"<IPOC>%d</IPOC>" % self.ipoc in self.here.recv(4096)


def test_a_telegram_that_comes_before_a_rehearsal_or_in_it_is_answered(monkeypatch):
    with Controller() as controller:
        session, rehearsed = controller.session, threading.Event()
        while not session.connected:
            controller.send()
            assert controller.is_answered()
        for _ in range(20):  # as soon as the last one was answered, so before the next is due
            controller.send()
            assert controller.is_answered()

        def interrupted(now, rehearse=session.rehearse):
            if not rehearsed.is_set():
                rehearsed.set()
                controller.send()
            rehearse(now)

        monkeypatch.setattr(session, "rehearse", interrupted)
        for _ in range(20):  # a busy computer is too late for some
            controller.send()
            assert controller.is_answered()
            if rehearsed.wait(1.0):
                break
        assert controller.is_answered()
