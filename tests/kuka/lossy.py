"""Networks that lose datagrams: a relay in this process, or two namespaces with netem between them."""

import random
import shutil
import socket
import subprocess
import threading
from contextlib import contextmanager

LOSS = 0.01


class Relay(threading.Thread):
    """Between a controller (which sends to ``port``) and a client that listens on ``target``; of both directions it loses one datagram,
    drawn at random, out of each 1 / loss."""

    def __init__(self, target, loss=LOSS, seed=1):
        super().__init__(daemon=True)
        self._target, self._block, self._seed = ("127.0.0.1", target), round(1.0 / loss), seed
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for each in (self._front, self._back):
            each.bind(("127.0.0.1", 0))
            each.settimeout(0.2)
        self.port, self._controller = self._front.getsockname()[1], None
        self.lost, self._quit = {"to the client": 0, "to the controller": 0}, threading.Event()
        self._answers = threading.Thread(
            target=self._carry, args=(self._back, self._front, lambda: self._controller, "to the controller"), daemon=True
        )

    def run(self):
        self._answers.start()
        self._carry(self._front, self._back, lambda: self._target, "to the client")

    def _carry(self, source, sink, where, name):
        draw, count, unlucky = random.Random(f"{name} {self._seed}"), 0, 0
        while not self._quit.is_set():
            try:
                data, sender = source.recvfrom(65536)
            except (TimeoutError, ConnectionError):
                continue
            if source is self._front:
                self._controller = sender
            if count % self._block == 0:
                unlucky = draw.randrange(self._block)
            count += 1
            if (count - 1) % self._block == unlucky:
                self.lost[name] += 1
            else:
                sink.sendto(data, where())

    def close(self):
        self._quit.set()
        self.join()
        self._answers.join()
        self._front.close()
        self._back.close()


@contextmanager
def relay(loss=LOSS):
    """(address to which the controller sends, address on which the client listens, port of both ends, command prefix of the client)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        target = probe.getsockname()[1]
    carrier = Relay(target, loss)
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
