"""What was written below a folder, as ``system_call_faults.c`` records it, and what a disk may hold of it after a power cut."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

BLOCK = 4096


@dataclass(frozen=True)
class Record:
    """kind: 'w' written, 's' synced, 'r' renamed to ``other``, 'u' unlinked, 'c' created (if it was not there), 't' emptied."""

    kind: str
    time_s: float
    path: str
    other: str
    at: int
    data: bytes


def records(log: bytes) -> Iterator[Record]:
    """The records of a log; a torn last one is left out."""
    place = 0
    while place + 17 <= len(log):
        kind, time_s, first, second = struct.unpack_from("<cdII", log, place)
        place += 17
        path, other = log[place : place + first], log[place + first : place + first + second]
        place += first + second
        if place + 16 > len(log):
            return
        at, size = struct.unpack_from("<qQ", log, place)
        place += 16
        data = log[place : place + size]
        place += size
        if len(data) < size:
            return
        yield Record(kind.decode(), time_s, path.decode().lstrip("/"), other.decode().lstrip("/"), at, data)


@dataclass
class File:
    """content: as the running system sees it; durable: as it was at the last sync; pending: what was done since."""

    content: bytearray = field(default_factory=bytearray)
    durable: bytes = b""
    pending: list[Record] = field(default_factory=list)


class Disk:
    """Files by name, the names that are on the disk, and what was done to names since: each a creation, a renaming or a removal."""

    def __init__(self, files: dict[str, bytes] | None = None) -> None:
        self.names = {path: File(bytearray(data), data) for path, data in (files or {}).items()}
        self.durable_names = dict(self.names)
        self.pending: list[tuple[Record, File]] = []

    def apply(self, record: Record) -> None:
        path = record.path
        if record.kind == "s" and path not in self.names:  # a folder: the names in it are on the disk
            for change, file in self.pending:
                if _folder(change.path) == path:
                    _rename(self.durable_names, change, file)
            self.pending = [(change, file) for change, file in self.pending if _folder(change.path) != path]
        elif record.kind == "s":
            file = self.names[path]
            file.durable, file.pending = bytes(file.content), []
        elif record.kind in "ru" and path in self.names:
            self._renamed(record, self.names[path])
        elif record.kind in "ctw":
            if path not in self.names:
                self._renamed(record, File())
            file = self.names[path]
            if record.kind == "t" and file.content:
                file.content.clear()
                file.pending.append(record)
            elif record.kind == "w":
                _write(file.content, record.at, record.data)
                file.pending.append(record)

    def _renamed(self, record: Record, file: File) -> None:
        _rename(self.names, record, file)
        self.pending.append((record, file))

    def after_cut(self, rng: random.Random | None) -> dict[str, bytes]:
        """Name -> content. rng: keeps unsynced blocks and names by chance; None keeps none. A renaming is kept or lost as a whole, as file
        systems with a journal promise; any of several may be lost."""
        names = dict(self.durable_names)
        for record, file in self.pending if rng is not None else ():
            if rng.random() < 0.5:
                _rename(names, record, file)
        return {name: _kept(file, rng) for name, file in names.items()}


def _rename(names: dict[str, File], record: Record, file: File) -> None:
    """What a record does to names: one comes, one goes, or both."""
    if record.kind in "ru":
        names.pop(record.path, None)
    if record.kind != "u":
        names[record.other if record.kind == "r" else record.path] = file


def _folder(path: str) -> str:
    return path.rpartition("/")[0]


def _kept(file: File, rng: random.Random | None) -> bytes:
    out = bytearray(file.durable)
    for record in file.pending if rng is not None else ():
        if record.kind == "t":
            out.clear()
        for start in range(0, len(record.data), BLOCK):
            if rng.random() < 0.5:
                _write(out, record.at + start, record.data[start : start + BLOCK])
    return bytes(out)


def _write(content: bytearray, at: int, data: bytes) -> None:
    if len(content) < at:
        content.extend(bytes(at - len(content)))
    content[at : at + len(data)] = data
