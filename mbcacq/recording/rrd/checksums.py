"""``checksums.jsonl`` of a run folder: the SHA-256 of each of its files that has no other copy, of a recording stretch by stretch."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from mbcacq.files.atomic_write import own_file, sync_file
from mbcacq.recording.rrd.checked_lines import Lines, checked_line, read_lines

FILE = "checksums.jsonl"
BLOCK_BYTES = 1 << 20
LARGE_BYTES = 256 << 20  # the checksum of more takes longer than to start a process


@dataclass(frozen=True)
class Stretch:
    """Bytes ``start`` to ``end`` of a file, as they were written; ``poses``: numbers of the poses that were finished in them."""

    file: str
    start: int
    end: int
    sha256: str
    poses: tuple[int, ...] = ()


def note_stretch(folder: Path, stretch: Stretch) -> None:
    """Append a line. Raises OSError."""
    entry = {"file": stretch.file, "start": stretch.start, "end": stretch.end, "poses": list(stretch.poses), "sha256": stretch.sha256}
    with own_file(folder / FILE).open("ab") as file:
        file.write(checked_line(entry))


def note_whole(folder: Path, name: str, data: bytes) -> None:
    """Note the checksum of a file that was written at once; it counts in place of an earlier one. A disk that takes no more leaves the file
    without a checksum."""
    with suppress(OSError):
        note_stretch(folder, Stretch(name, 0, len(data), hashlib.sha256(data).hexdigest()))


def note_made(partial: Path, path: Path) -> None:
    """Note the checksum of a file that was made from the recording and is about to take the name of another, where its folder has
    checksums.

    The line is on the disk before the file has its name: whichever of the two a power cut leaves, its checksum is known.
    """
    with suppress(OSError):
        if (path.parent / FILE).exists():
            digest, size = digest_of_file(partial, 0, partial.stat().st_size)
            note_stretch(path.parent, Stretch(path.name, 0, size, digest))
            sync_file(path.parent / FILE)


def read_stretches(folder: Path) -> tuple[dict[str, list[Stretch]], Lines]:
    """File -> its stretches in order, and the lines themselves. Nothing for a run of an earlier version."""
    noted, lines = _noted(folder)
    found: dict[str, list[Stretch]] = {}
    for stretch in noted:
        found[stretch.file] = [*(found.get(stretch.file, []) if stretch.start else []), stretch]
    return found, lines


def read_versions(folder: Path) -> dict[str, list[Stretch]]:
    """File -> what was noted of it from its first byte on: each version of a file that is replaced as a whole."""
    found: dict[str, list[Stretch]] = {}
    for stretch in _noted(folder)[0]:
        if not stretch.start:
            found.setdefault(stretch.file, []).append(stretch)
    return found


def is_version(path: Path, versions: Sequence[Stretch]) -> bool:
    """Whether a file is, byte for byte, one of those that were noted. Raises OSError."""
    size = path.stat().st_size
    candidates = {stretch.sha256 for stretch in versions if stretch.end == size}
    return bool(candidates) and digest_of_file(path, 0, size)[0] in candidates


def _noted(folder: Path) -> tuple[list[Stretch], Lines]:
    """The stretches of all files as they were noted, and the lines."""
    try:
        lines = read_lines(folder / FILE)
    except OSError:
        return [], Lines([], ())
    found: list[Stretch] = []
    for entry in lines.entries:
        with suppress(KeyError, TypeError, ValueError, OverflowError):
            poses = tuple(int(pose) for pose in entry["poses"])
            stretch = Stretch(str(entry["file"]), int(entry["start"]), int(entry["end"]), str(entry["sha256"]), poses)
            if 0 <= stretch.start <= stretch.end:
                found.append(stretch)
    return found, lines


def digest_of_file(path: Path, start: int, end: int) -> tuple[str, int]:
    """SHA-256 of the bytes start to end, and where the file ended if that is before. Raises OSError."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        file.seek(start)
        for block in blocks(file, end - start):
            digest.update(block)
            start += len(block)
    return digest.hexdigest(), start


def blocks(file: IO[bytes], size: int) -> Iterator[bytes]:
    """The next ``size`` bytes of a file, or those that it has. Raises OSError."""
    while size > 0 and (block := file.read(min(BLOCK_BYTES, size))):
        yield block
        size -= len(block)


def is_as_written(path: Path) -> bool:
    """Whether every byte of a file of moderate size has a checksum that holds."""
    try:
        size, end = path.stat().st_size, 0
        if size > LARGE_BYTES:
            return False
        for stretch in read_stretches(path.parent)[0].get(path.name, []):
            if stretch.start != end or digest_of_file(path, end, stretch.end) != (stretch.sha256, stretch.end):
                break
            end = stretch.end
        return 0 < size and (size == end or is_version(path, read_versions(path.parent).get(path.name, [])))
    except OSError:
        return False


def digest_of_values(values: Mapping[str, Any]) -> str:
    """SHA-256 of named values: arrays by type and bytes, lists of str by their text. None counts as absent."""
    digest = hashlib.sha256()
    for name in sorted(name for name, value in values.items() if value is not None):
        value = values[name]
        if isinstance(value, str) or isinstance(value, Sequence) and all(isinstance(item, str) for item in value):
            texts = [item.encode("utf-8", errors="surrogatepass") for item in ([value] if isinstance(value, str) else value)]
            kind, data = "text", b"".join(len(item).to_bytes(8, "little") + item for item in texts)
        else:
            array = np.atleast_1d(np.asarray(value))
            array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
            kind, data = array.dtype.str, array.tobytes()
        digest.update(f"{name}:{kind}:{len(data)}:".encode() + data)
    return digest.hexdigest()
