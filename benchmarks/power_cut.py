"""A power cut at a moment of a run: what was written since the last sync is lost. Can the folder be resumed, and is nothing in it wrong?

    python benchmarks/power_cut.py [--moments 60] [--seed 0] [--resume-every 10]

``system_call_faults.c`` records every write, sync, rename and new name below the folder of a run. For a moment drawn among these records
the folder is built as a disk could hold it then: 'lost' keeps only what was synced (contents by fsync of the file, names by fsync of the
folder), 'some' keeps each unsynced block of 4 KiB and each unsynced name with probability one half. Then the run is resumed, every so often
to its end. Linux, gcc.
"""

from __future__ import annotations

import argparse
import random
import shutil
import struct
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from disturbed_run import CELL, DisturbedRuns, Ending, preload

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
        systems with a journal promise; of several, any may be lost."""
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--resume-every", type=int, default=10)
    given = parser.parse_args()
    runs = DisturbedRuns(preload())
    from mbcacq.workflow.resume import resumed_progress

    whole, log = runs.work / "whole", runs.work / "log"
    ending = runs.run(lambda: runs.library.fault_record(str(whole).encode(), str(log).encode()), whole, False)
    assert ending.how == "goes on", ending
    found = list(records(log.read_bytes()))
    replayed = Disk()
    for record in found:
        replayed.apply(record)
    for name, file in replayed.names.items():  # the log is complete, or nothing below is worth anything
        if (whole / name).is_file() and name != ".run.lock.json":
            assert (whole / name).read_bytes() == bytes(file.content), name
    print(f"{len(found)} records: " + ", ".join(f"{n} {kind}" for kind, n in Counter(record.kind for record in found).items()), flush=True)
    rng, table, bad = random.Random(given.seed), Counter(), 0
    for case in range(given.moments):
        moment, how = rng.randrange(len(found) + 1), ("lost", "some")[case % 2]
        disk = Disk()
        for record in found[:moment]:
            disk.apply(record)
        folder = runs.work / "cut"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for name, content in disk.after_cut(rng if how == "some" else None).items():
            (folder / name).write_bytes(content)
        wrong = runs.left_behind(folder, Ending("cut"))
        if not wrong and case % given.resume_every == 0 and (folder / "plan.yaml").exists():
            wrong = runs.resumed(folder)
        held = len(resumed_progress(folder, runs.loaded, CELL).done) if not wrong and (folder / "plan.yaml").exists() else 0
        table[how, "not good" if wrong else f"{held} poses kept"] += 1
        bad += bool(wrong)
        if wrong:
            print(f"  {how} at record {moment}: {'; '.join(wrong)}", flush=True)
    runs.close()
    ways = sorted({way for _, way in table})
    print("\n| unsynced writes | " + " | ".join(ways) + " |\n|---|" + "---|" * len(ways))
    for how in ("lost", "some"):
        print(f"| {how} | " + " | ".join(str(table[how, way] or "") for way in ways) + " |")
    print(f"\n{given.moments} moments, {bad} not good")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
