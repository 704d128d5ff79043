"""What may happen to a message between device and driver, and where one message ends."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

ACTIONS = ("drop", "delay", "truncate", "duplicate", "garbage", "close")
FLIP = "flip"  # one bit: what a checksum finds, and a line of text without one does not
SHAPES = ("split", "join")  # the same bytes in other segments: on a stream no fault at all
Sender = Literal["device", "driver"]
DEVICE: Sender = "device"
DRIVER: Sender = "driver"
CLOSE = object()

Cut = Callable[[bytes], int]


@dataclass(frozen=True)
class Fault:
    """What happens to message ``index`` (from 0, of those that ``sender`` sends) and, with ``lasting``, all later ones.

    drop; delay by ``seconds``; truncate: the first half arrives; duplicate; garbage: random bytes of the same length; close: the first half
    arrives, then the connection ends (a datagram is lost); flip: one bit of it, chosen at random; split: byte by byte; join: in one segment
    with the next.
    """

    sender: Sender
    index: int
    action: str
    seconds: float = 1.0
    lasting: bool = False

    def __post_init__(self) -> None:
        if self.action not in (known := (*ACTIONS, FLIP, *SHAPES)):
            raise ValueError(f"there is no fault '{self.action}' (known: {', '.join(known)})")

    def concerns(self, sender: str, number: int) -> bool:
        """Whether it changes that message."""
        return sender == self.sender and (number == self.index or (self.lasting and number > self.index))


def as_read(data: bytes) -> int:
    """A message is whatever one read returns: right for protocols that wait for each answer."""
    return len(data)


def counted(at: int = 0, size: int = 4, order: Literal["little", "big"] = "little", plus: int = 0) -> Cut:
    """A length field of ``size`` bytes at ``at``; the message has that many bytes ``plus`` more."""

    def cut(data: bytes) -> int:
        if len(data) < at + size:
            return 0
        length = max(int.from_bytes(data[at : at + size], order) + plus, at + size)
        return length if len(data) >= length else 0

    return cut


def ended(by: bytes) -> Cut:
    """A message ends with these bytes."""

    def cut(data: bytes) -> int:
        found = data.find(by)
        return 0 if found < 0 else found + len(by)

    return cut


class Channel:
    """One link's messages of both senders: counted, noted as they come, and changed by the fault that is set.

    ``pass_on`` gives what is to be done in order: bytes to send, seconds to wait, or CLOSE. ``connection`` is which of the link's
    connections a message came by: what is held to be joined goes to no other one, though several are open while an old one ends.
    """

    def __init__(self, name: str, note: Callable[[str, str, bytes], None] = lambda *_: None, seed: int = 0) -> None:
        self.name, self._note = name, note
        self.fault: Fault | None = None
        self.struck = 0
        self.count: dict[str, int] = {DEVICE: 0, DRIVER: 0}
        self._held: dict[tuple[str, object], bytes] = {}
        self._random = random.Random(seed)
        self._lock = threading.Lock()

    def set(
        self,
        action: str,
        sender: Sender = DEVICE,
        *,
        lasting: bool = False,
        seconds: float = 1.0,
        index: int | None = None,
        seed: int | None = None,
    ) -> None:
        """By default to the next message of that sender. seed: of what is drawn at random from here on."""
        with self._lock:
            if seed is not None:
                self._random.seed(seed)
            self.struck = 0
            self.fault = Fault(sender, self.count[sender] if index is None else index, action, seconds, lasting)

    def heal(self) -> None:
        self.fault = None

    def pass_on(self, sender: str, message: bytes, connection: object = None) -> list[object]:
        with self._lock:
            self._note(self.name, sender, message)
            number = self.count[sender]
            self.count[sender] += 1
            fault, held = self.fault, self._held.pop((sender, connection), b"")
            out: list[object] = [held + message]
            if fault is not None and fault.concerns(sender, number):
                self.struck += 1
                if not held:
                    out = self._changed(fault, message)
                if fault.action == "join" and not held:
                    self._held[sender, connection] = message
            return out

    def flush(self, sender: str, connection: object = None) -> bytes:
        """The bytes that wait for a next message that has not come."""
        with self._lock:
            return self._held.pop((sender, connection), b"")

    def _changed(self, fault: Fault, message: bytes) -> list[object]:
        half = message[: max(1, len(message) // 2)]
        return {
            "drop": lambda: [],
            "delay": lambda: [fault.seconds, message],
            "truncate": lambda: [half],
            "duplicate": lambda: [message, message],
            "garbage": lambda: [self._random.randbytes(len(message))],
            "close": lambda: [half, CLOSE],
            FLIP: lambda: [self._flipped(message)],
            "split": lambda: [message[i : i + 1] for i in range(len(message))],
            "join": lambda: [],
        }[fault.action]()

    def _flipped(self, message: bytes) -> bytes:
        bit = self._random.randrange(8 * len(message))
        return (int.from_bytes(message, "little") ^ 1 << bit).to_bytes(len(message), "little")
