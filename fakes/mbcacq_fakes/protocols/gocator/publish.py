"""Channels on which the sensor only talks: data and health. Every client has a queue and a thread, so a slow one delays nobody."""

from __future__ import annotations

import queue
import select
import socket
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

CLOSE, MUTE = object(), object()
_DEPTH = 32


class Client:
    """Writes what is put into its queue; CLOSE ends the connection, MUTE keeps it open and silent from then on."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.queue: queue.Queue = queue.Queue(_DEPTH)
        self.gone = False
        self._muted = False
        self._thread = threading.Thread(target=self._run, name="fake-gocator-writer", daemon=True)
        self._thread.start()

    def put(self, items: Sequence[object], patience_s: float = 0.0) -> None:
        """A client that does not read for so long loses data sets whole, as a sensor drops them."""
        deadline = time.monotonic() + patience_s
        while self.queue.qsize() + len(items) > _DEPTH and not self.gone and time.monotonic() < deadline:
            time.sleep(0.001)
        if self.queue.qsize() + len(items) <= _DEPTH:
            for item in items:
                self.queue.put(item)

    @property
    def listening(self) -> bool:
        """False once the other side has closed; it never sends, so anything to read is the end."""
        if self.gone:
            return False
        try:
            readable, _, _ = select.select([self.sock], [], [], 0)
            return not readable or bool(self.sock.recv(1, socket.MSG_PEEK))
        except (OSError, ValueError):  # reset, or closed meanwhile
            return False

    def close(self) -> None:
        self.gone = True
        with suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)
        with suppress(queue.Full):
            self.queue.put_nowait(CLOSE)
        self._thread.join(2.0)
        self.sock.close()

    def _run(self) -> None:
        try:
            while not self.gone:
                item = self.queue.get()
                if item is CLOSE:
                    break
                if item is MUTE:
                    self._muted = True
                elif not self._muted:
                    self.sock.sendall(item)
        except OSError:
            pass
        self.gone = True
        self.sock.close()


class Publisher:
    """The clients of one channel."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clients: list[Client] = []

    def add(self, sock: socket.socket, first: Sequence[object] = ()) -> None:
        client = Client(sock)
        client.put(first)
        with self._lock:
            gone = [c for c in self._clients if not c.listening]
            self._clients = [c for c in self._clients if c not in gone] + [client]
        for old in gone:
            old.close()

    def publish(self, items: Sequence[object], patience_s: float = 0.0) -> None:
        with self._lock:
            clients = list(self._clients)
        for client in clients:
            client.put(items, patience_s)

    @property
    def count(self) -> int:
        with self._lock:
            return sum(c.listening for c in self._clients)

    def wait_for_client(self, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while self.count == 0 and time.monotonic() < deadline:
            time.sleep(0.002)
        return self.count > 0

    def close(self) -> None:
        with self._lock:
            clients, self._clients = self._clients, []
        for client in clients:
            client.close()
