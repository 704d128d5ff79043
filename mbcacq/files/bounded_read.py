"""Files of other people, read up to a size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mbcacq.errors import ConfigError

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


def bytes_of(path: Path, most: int, cure: str, smaller: str = "split it") -> bytes:
    """The bytes of a file of at most so many. cure, smaller: what to do where it cannot be read, or is larger. Raises ConfigError."""
    try:
        data = read_bounded(path, most)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; {cure}") from error
    if len(data) > most:
        raise ConfigError(f"{path}: larger than {most / 2**20:.4g} MiB; {smaller}")
    return data


def kind_of(path: Path, kinds: Sequence[str], what: str, most: int) -> str:
    """The suffix of a file that is there, is of one of these kinds, and has at most so many bytes. Raises ConfigError."""
    kind = path.suffix.lower()
    if kind not in kinds:
        raise ConfigError(f"{path}: a {what} must be one of {', '.join(kinds)}; save it in one of these formats")
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such {what}; correct the path")
    if not 0 < (size := path.stat().st_size) <= most:
        raise ConfigError(f"{path}: {f'{size / 2**30:.1f} GiB are too much for one {what}' if size else 'is empty'}; save it anew")
    return kind
