"""One TCP connection to the controller's channel: whole telegrams in, commands out."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from mbcacq.devices import ConnectError, LinkLost, ProtocolError, TcpLink
from mbcacq_kuka.eki.framing import Cutter, FramingError
from mbcacq_kuka.eki.telegrams import AXES, BEAT, BadTelegram, Hello, State, command, parse

RETRY_S = 0.1
_SEND_S, _LONGEST_S = 1.0, 5.0


class Link(TcpLink):
    """Whole telegrams. ``telegrams`` is for one thread, ``send`` for any."""

    def __init__(self, address: str, port: int, timeout_s: float, names: Sequence[str] = AXES) -> None:
        """names: of the axes. Raises ConnectError."""
        self._names = names
        self.where, self._cutter = f"{address}:{port}", Cutter("Robot")
        try:
            super().__init__("the controller", address, port, timeout_s, _SEND_S)
        except (OSError, UnicodeError) as error:
            raise ConnectError(
                f"the controller's EKI channel {self.where} cannot be reached ({error}); is its link program running in the "
                "submit interpreter, is the address right, does another client hold the channel?"
            ) from error

    def telegrams(self, timeout_s: float) -> list[tuple[float, Hello | None, State | None]]:
        """What has come, with the time of its arrival; empty if nothing did. Raises LinkLost, ProtocolError."""
        now, data = self.receive(timeout_s)
        try:
            return [(now, *parse(telegram, self._names)) for telegram in self._cutter.feed(data)]
        except (FramingError, BadTelegram) as error:
            raise ProtocolError(f"the controller at {self.where} sent a useless telegram: {error}; the arm is stopped") from error


def dial(address: str, port: int, wait_s: float, quit_event: threading.Event, names: Sequence[str] = AXES) -> Link:
    """Connect, trying again while the controller makes its channel new, until ``quit_event``. Raises ConnectError."""
    deadline = time.monotonic() + wait_s
    while True:
        try:
            link = Link(address, port, max(RETRY_S, min(wait_s, _LONGEST_S)), names)
            try:
                link.send(command(BEAT, names=names))  # EKI 6 knows of a client only by its first telegram
            except LinkLost as error:
                link.close()
                raise ConnectError(f"the controller's EKI channel {link.where} hung up at once ({error})") from error
            return link
        except ConnectError:
            if quit_event.wait(RETRY_S) or time.monotonic() > deadline:
                raise
