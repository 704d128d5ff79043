"""A parser of bytes from outside with valid inputs to start from, and what helps to make one."""

from __future__ import annotations

import atexit
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mbcacq_kuka.eki import telegrams
from mbcacq_kuka.eki.framing import FramingError
from mbcacq_kuka.rsi.telegram import Malformed

from mbcacq.errors import MbcacqError

OURS = (MbcacqError, Malformed, FramingError, telegrams.BadTelegram)  # the last three become ProtocolError one call above
MEMORY = os.environ.get("XDG_RUNTIME_DIR") or ("/dev/shm" if os.path.isdir("/dev/shm") else None)


@dataclass(frozen=True)
class Target:
    """``parse(data)`` ends in a value or one of our errors, or it is a bug."""

    name: str
    seeds: tuple[bytes, ...]
    parse: Callable[[bytes], object]

    def run(self, data: bytes) -> bool:
        """True if it was accepted, False if refused with one of our errors; anything else passes."""
        try:
            self.parse(data)
        except OURS:
            return False
        return True


def in_file(name: str, read: Callable[[Path], object], other_files: dict[str, bytes] | None = None) -> Callable[[bytes], object]:
    """A parser that reads a file, in memory where the system has it. The file stands alone, or in a folder with others."""
    path: Path | None = None

    def parse(data: bytes) -> object:
        nonlocal path
        if path is None:  # made with the first input: most of the folders are never needed
            made = tempfile.TemporaryDirectory(prefix="fuzz-", dir=MEMORY)
            atexit.register(made.cleanup)
            path = Path(made.name) / name
            path.parent.mkdir(exist_ok=True)
            for other, content in (other_files or {}).items():
                (Path(made.name) / other).write_bytes(content)
        path.write_bytes(data)
        return read(path)

    return parse
