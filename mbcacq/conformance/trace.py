"""The bytes of a session, in order, as a text file; and a device that plays them back."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from mbcacq.conformance.faults import DEVICE, DRIVER
from mbcacq.files.atomic_write import write_file

_AGAIN_S = 0.05


class TraceLine(NamedTuple):
    link: str
    sender: str
    data: bytes


class Trace:
    """Lines in the order in which they passed; give ``note`` to every channel of a stand."""

    def __init__(self, lines: list[TraceLine] | None = None) -> None:
        self.lines = lines or []
        self._lock = threading.Lock()

    def note(self, link: str, sender: str, data: bytes) -> None:
        with self._lock:
            self.lines.append(TraceLine(link, sender, data))

    def save(self, path: Path | str) -> None:
        """One line a message: link, sender, bytes in hex."""
        with self._lock:
            write_file(path, "".join(f"{link} {sender} {data.hex()}\n" for link, sender, data in self.lines))

    @classmethod
    def load(cls, path: Path | str) -> Trace:
        """Raises ValueError for a file that is none."""
        lines = []
        for row in Path(path).read_text(encoding="ascii").splitlines():
            link, sender, data = row.split(" ")
            if sender not in (DEVICE, DRIVER):
                raise ValueError(f"{path}: '{sender}' is neither {DEVICE} nor {DRIVER}")
            lines.append(TraceLine(link, sender, bytes.fromhex(data)))
        return cls(lines)


class Replay:
    """Plays the device's side of a trace: waits for what the driver sent then, answers what the device answered then.

    ``ports``: TCP port by link, where the driver shall connect. A link in ``datagrams`` (name -> address of the driver) speaks UDP.
    ``differences``: where the driver sent other bytes than in the trace.
    """

    def __init__(self, trace: Trace, datagrams: dict[str, tuple[str, int]] | None = None, timeout_s: float = 20.0) -> None:
        self._lines, self._timeout_s = list(trace.lines), timeout_s
        self._listeners: dict[str, socket.socket] = {}
        self._links: dict[str, socket.socket] = {}
        self._closing = threading.Event()
        self.differences: list[tuple[int, bytes, bytes]] = []
        self.played = 0
        for link in {line.link for line in self._lines}:
            if datagrams and link in datagrams:
                self._links[link] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._links[link].connect(datagrams[link])
            else:
                self._listeners[link] = socket.create_server(("127.0.0.1", 0))
        self.ports = {link: listener.getsockname()[1] for link, listener in self._listeners.items()}
        self._datagrams = set(datagrams or ())
        self._unanswered: dict[str, list[bytes]] = {link: [] for link in self._datagrams}  # sent by the device, oldest first
        self._taken: dict[str, set[bytes]] = {link: set() for link in self._datagrams}  # answers that were played already
        self._thread = threading.Thread(target=self._play, name="replay", daemon=True)
        self._thread.start()

    @property
    def finished(self) -> bool:
        """All that was in the trace has passed."""
        return self.played == len(self._lines)

    def stop(self) -> None:
        self._closing.set()
        for sock in (*self._listeners.values(), *self._links.values()):
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
            sock.close()
        self._thread.join(5.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _play(self) -> None:
        try:
            for number, line in enumerate(self._lines):
                link = self._link(line.link)
                if line.sender == DEVICE:
                    self._send(link, line)
                else:
                    got = self._receive(link, line)
                    if got != line.data:
                        self.differences.append((number, line.data, got))
                self.played += 1
        except OSError:
            pass

    def _send(self, link: socket.socket, line: TraceLine) -> None:
        if line.link in self._datagrams:
            self._unanswered[line.link].append(line.data)
        try:
            link.sendall(line.data)
        except ConnectionRefusedError:  # a datagram before the driver listens; it is sent again while its answer is waited for
            if line.link not in self._datagrams:
                raise

    def _receive(self, link: socket.socket, line: TraceLine) -> bytes:
        if line.link in self._datagrams:
            return self._datagram(link, line)
        link.settimeout(self._timeout_s)
        data = b""
        while len(data) < len(line.data):
            part = link.recv(len(line.data) - len(data))
            if not part:
                raise ConnectionError
            data += part
        return data

    def _datagram(self, link: socket.socket, line: TraceLine) -> bytes:
        """A message without an answer is sent again: nobody may have listened yet. A second answer to what was sent twice is passed
        over."""
        unanswered, taken = self._unanswered[line.link], self._taken[line.link]
        deadline, wait_s = time.monotonic() + self._timeout_s, _AGAIN_S
        while not self._closing.is_set() and time.monotonic() < deadline:
            link.settimeout(wait_s)
            try:
                data = link.recv(1 << 16)
                if data != line.data and data in taken:
                    continue
                del unanswered[:1]
                taken.add(data)
                return data
            except ConnectionRefusedError:
                self._closing.wait(_AGAIN_S)
            except TimeoutError:
                wait_s = min(2 * wait_s, 1.0)
            with suppress(ConnectionRefusedError):  # all of them later, so that none overtakes another
                for telegram in unanswered:
                    link.send(telegram)
        raise TimeoutError

    def _link(self, name: str) -> socket.socket:
        if name not in self._links:
            listener = self._listeners[name]
            listener.settimeout(self._timeout_s)
            self._links[name], _ = listener.accept()
            self._links[name].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._links[name]
