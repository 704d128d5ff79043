"""Files of other people, read up to a size."""

from __future__ import annotations

from pathlib import Path

_BLOCK = 1 << 20


def read_bounded(path: Path, most: int) -> bytes:
    """The bytes of a file; a larger one gives ``most + 1`` bytes.

    Memory is taken as bytes come in: ``file.read(most)`` takes all of it at once, which a limit of address space refuses. Raises OSError.
    """
    out = bytearray()
    with path.open("rb") as file:
        while len(out) <= most and (block := file.read(min(_BLOCK, most + 1 - len(out)))):
            out += block
    return bytes(out)
