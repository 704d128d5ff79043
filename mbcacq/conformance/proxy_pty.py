"""A serial line through something in the middle: a pseudo-terminal for the driver, a TCP port where the device is played.

Needs POSIX: Windows has no pseudo-terminals.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import tempfile
import threading
from contextlib import suppress
from functools import partial

from mbcacq.conformance.faults import DEVICE, DRIVER, Channel, Cut, as_read
from mbcacq.conformance.proxy import POLL_S, Proxy, send_all, shut


class PtyProxy(Proxy):
    """A pseudo-terminal at ``path`` in front of a serial device that is played on a TCP port. A cut ends the terminal.

    Raises OSError on Windows.
    """

    def __init__(self, channel: Channel, device: tuple[str, int], *, cut: Cut = as_read, cut_driver: Cut = as_read) -> None:
        super().__init__(channel)
        if sys.platform == "win32":
            raise OSError("there are no pseudo-terminals on Windows; use a TcpProxy and socket://")
        self._device, self._cut = device, {DEVICE: cut, DRIVER: cut_driver}
        self._folder = tempfile.TemporaryDirectory(prefix="pty-")
        self.path = os.path.join(self._folder.name, "serial")
        self._fds: tuple[int, ...] = ()
        self._plugged = threading.Event()
        self._far: socket.socket | None = None
        self._plug()
        self._spawn(self._run)

    @property
    def ready(self) -> bool:
        return self._plugged.is_set()

    def refuse(self, refusing: bool) -> None:
        super().refuse(refusing)
        self._name()

    def cut(self) -> None:
        """Pull the plug; it is put in again at once, as a new device under the same name."""
        self._plugged.clear()
        if self._far is not None:
            shut(self._far)

    def stop(self) -> None:
        super().stop()
        self._unplug()
        self._folder.cleanup()

    def _plug(self) -> None:
        import tty

        master, slave = os.openpty()
        tty.setraw(slave)
        self._fds = (master, slave)
        self._name()
        self._plugged.set()

    def _name(self) -> None:
        if self._fds and not self.refusing:
            os.symlink(os.ttyname(self._fds[1]), f"{self.path}.new")
            os.replace(f"{self.path}.new", self.path)  # the name never leads nowhere while the cable is in
        else:
            with suppress(FileNotFoundError):
                os.unlink(self.path)

    def _unplug(self) -> None:
        fds, self._fds = self._fds, ()
        for fd in fds:
            os.close(fd)

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                self._far = far = socket.create_connection(self._device, 5.0)
                far.settimeout(POLL_S)
            except OSError:  # nobody there yet, or the plug was pulled meanwhile
                self._closing.wait(POLL_S)
                continue
            ends = [threading.Thread(target=self._pump, args=(sender, far), daemon=True) for sender in (DRIVER, DEVICE)]
            for end in ends:
                end.start()
            for end in ends:
                end.join()
            far.close()
            self._unplug()
            if not self._closing.is_set():
                self._plug()

    def _pump(self, sender: str, far: socket.socket) -> None:
        master = self._fds[0]

        def from_driver() -> bytes | None:
            if not self._plugged.is_set():
                return None
            ready = select.select([master], [], [], POLL_S)[0]
            return os.read(master, 1 << 16) if ready else b""

        def from_device() -> bytes | None:
            if not self._plugged.is_set():
                return None
            try:
                return far.recv(1 << 16) or None
            except TimeoutError:
                return b""

        receive, send = (from_driver, partial(send_all, far)) if sender == DRIVER else (from_device, partial(os.write, master))
        with suppress(OSError):
            self._relay(sender, receive, send, self._cut[sender])
        self._plugged.clear()
