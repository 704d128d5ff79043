"""Networks that lose datagrams: a relay in this process, or two namespaces with netem between them."""

import heapq
import os
import random
import select
import shutil
import socket
import subprocess
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from mbcacq_fakes.cell.ports import free_port

LOSS = 0.01


@dataclass(frozen=True)
class Weather:
    """What a network does to each datagram. loss, repeat, reorder: shares of the datagrams; exactly one of each 1 / loss, drawn at random,
    is lost. jitter_s: largest delay; hold_s: how long a datagram is held back so that a later one overtakes it."""

    loss: float = LOSS
    repeat: float = 0.0
    reorder: float = 0.0
    jitter_s: float = 0.0
    hold_s: float = 0.0


class Relay(threading.Thread):
    """Between a controller (which sends to ``port``) and a client that listens on ``target``, in both directions."""

    def __init__(self, target, weather, seed=1, port=0):
        super().__init__(daemon=True)
        self._weather, self._draw, self._quit = weather, random.Random(seed), threading.Event()
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._front.bind(("127.0.0.1", port))
        self._back.bind(("127.0.0.1", 0))
        self.port = self._front.getsockname()[1]
        self._where = {self._front: None, self._back: ("127.0.0.1", target)}
        self._names = {self._front: "to the client", self._back: "to the controller"}  # by the side from which they come
        self._count, self._unlucky = dict.fromkeys(self._where, 0), dict.fromkeys(self._where, 0)
        self.lost = {"to the client": 0, "to the controller": 0}
        self._waiting = []

    def run(self):
        with suppress(AttributeError, OSError):  # where it is permitted the network does not wait for what else the machine has to do
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(45))
        while not self._quit.is_set():
            wait = min(0.2, max(0.0, self._waiting[0][0] - time.monotonic())) if self._waiting else 0.2
            for source in select.select([self._front, self._back], [], [], wait)[0]:
                data, sender = source.recvfrom(65536)
                if source is self._front:
                    self._where[self._front] = sender
                self._take(source, data)
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                _, _, source, data = heapq.heappop(self._waiting)
                self._deliver(source, data)

    def _deliver(self, source, data):
        sink = self._back if source is self._front else self._front
        sink.sendto(data, self._where[sink])

    def _take(self, source, data):
        if self._is_lost(source):
            self.lost[self._names[source]] += 1
            return
        self._send(source, data)
        if self._draw.random() < self._weather.repeat:
            self._send(source, data)

    def _is_lost(self, source):
        block = round(1.0 / self._weather.loss)
        count = self._count[source]
        if count % block == 0:
            self._unlucky[source] = self._draw.randrange(block)
        self._count[source] += 1
        return count % block == self._unlucky[source]

    def _send(self, source, data):
        held = self._weather.hold_s if self._draw.random() < self._weather.reorder else 0.0
        due = time.monotonic() + held + self._draw.uniform(0.0, self._weather.jitter_s)
        heapq.heappush(self._waiting, (due, self._draw.random(), source, data))

    def close(self):
        self._quit.set()
        self.join()
        self._front.close()
        self._back.close()


@contextmanager
def relay(weather=None):
    """(address to which the controller sends, address on which the client listens, port of both ends, command prefix of the client)."""
    target = free_port()
    carrier = Relay(target, weather or Weather())
    carrier.start()
    try:
        yield ("127.0.0.1", carrier.port), ("127.0.0.1", target), []
    finally:
        carrier.close()
        assert min(carrier.lost.values()) > 0


def why_no_netem():
    """'' where namespaces and netem work, else the reason."""
    if shutil.which("ip") is None or shutil.which("tc") is None:
        return "ip or tc is not installed"
    name = "mbcacqprobe"
    if (made := subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)).returncode:
        return f"no network namespaces: {made.stderr.strip()}"
    try:
        done = subprocess.run(
            ["ip", "netns", "exec", name, "tc", "qdisc", "add", "dev", "lo", "root", "netem", "loss", "1%"], capture_output=True, text=True
        )
        return f"no netem: {done.stderr.strip()}" if done.returncode else ""
    finally:
        subprocess.run(["ip", "netns", "del", name], check=True)


@contextmanager
def namespaces(loss=LOSS):
    """As ``relay``: the client in a namespace of its own, netem on both ends of the wire."""
    name, ours, theirs = "mbcacqlossy", "mbcq0", "mbcq1"

    def ip(*words):
        subprocess.run(["ip", *words], check=True, capture_output=True)

    ip("netns", "add", name)
    try:
        ip("link", "add", ours, "type", "veth", "peer", "name", theirs, "netns", name)
        inside = ["ip", "netns", "exec", name]
        ip("addr", "add", "10.213.77.1/30", "dev", ours)
        ip("link", "set", ours, "up")
        for words in (
            ["ip", "addr", "add", "10.213.77.2/30", "dev", theirs],
            ["ip", "link", "set", theirs, "up"],
            ["ip", "link", "set", "lo", "up"],
        ):
            subprocess.run([*inside, *words], check=True)
        if loss:
            for prefix, device in (([], ours), (inside, theirs)):
                subprocess.run([*prefix, "tc", "qdisc", "add", "dev", device, "root", "netem", "loss", f"{100 * loss}%"], check=True)
        yield ("10.213.77.2", 49152), ("10.213.77.2", 49152), inside
    finally:
        ip("netns", "del", name)  # the wire goes with it
