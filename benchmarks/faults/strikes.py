"""Kills, power cuts and full disks against a command that writes, one by one, and what stands there afterwards."""

from __future__ import annotations

import ctypes
import random
import shutil
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from faults.preloaded import FOREIGN, Work, full_from, in_child, killed_at, recorded
from faults.replayed_disk import Disk, Record, records

REPLAYED = ("kill, replayed", "power cut, lost", "power cut, some kept")
Files = dict[str, bytes]


class Struck(ABC):
    """A command, run once undisturbed while what it writes below ``folder`` is recorded.

    moments: at most so many of the replay. strikes: at most so many real runs that are killed, and that find the disk full. in_any_order:
    a campaign that is ended early has some of each kind.
    """

    in_any_order: ClassVar[bool] = False

    def __init__(self, name: str, work: Path, library: ctypes.CDLL, moments: int, strikes: tuple[int, int]) -> None:
        self.name, self.folder, self._library = name, work / "out", library
        self._most, self._strikes = moments, strikes
        self._log, self._count = work / "log", work / "count"

    @abstractmethod
    def fresh(self) -> Files:
        """Lay the folder out as it is before the command; what it holds."""

    @abstractmethod
    def begin(self) -> Work:
        """The command."""

    @abstractmethod
    def judged(self, code: int | None) -> str:
        """'old', 'new', 'between', or 'neither' with the reason. code: exit code of the command that was struck, None in a replay."""

    def lay(self, files: Files, moment: int) -> None:
        """Make the folder hold these files."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        for path, data in files.items():
            (self.folder / path).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / path).write_bytes(data)

    def record(self) -> None:
        """Run the command undisturbed; its folder is left as it is then."""
        self._old = self.fresh()
        self._log.unlink(missing_ok=True)
        if code := in_child(recorded(self._library, self.folder, self._log, self.begin())):
            raise SystemExit(f"{self.name}: exit code {code} undisturbed")
        self.records = list(records(self._log.read_bytes()))
        self._begin_replay()

    def _begin_replay(self) -> None:
        self._disk, self._done = Disk(self._old), 0

    def planned(self, rng: random.Random) -> list[tuple[str, int]]:
        """Kind and number of each strike: a moment among the records, an event, a write."""
        writes = sum(record.kind == "w" for record in self.records)
        self.fresh()
        if code := in_child(killed_at(1 << 60, self.folder, self.begin(), self._count)):
            raise SystemExit(f"{self.name}: exit code {code} undisturbed")
        events = int(self._count.read_text())
        print(f"{self.name}: {len(self.records)} records, {writes} writes, {events} events", flush=True)
        kills, full = (sorted(rng.sample(range(n), min(most, n))) for n, most in zip((events, writes), self._strikes, strict=True))
        replayed = [(kind, moment) for moment in drawn(self._most, self.records, rng) for kind in REPLAYED]
        out = [*replayed, *(("kill", n + 1) for n in kills), *(("full disk", n) for n in full)]
        if self.in_any_order:
            rng.shuffle(out)
        return out

    def strike(self, kind: str, number: int, rng: random.Random) -> tuple[str, str]:
        """Exit of the command, and what stood there."""
        if kind in REPLAYED:
            self.lay(self._state(kind, number, rng), number)
            return "-", self.judged(None)
        self.fresh()
        work = self.begin()
        code = in_child(killed_at(number, self.folder, work) if kind == "kill" else full_from(number, self._library, self.folder, work))
        if code in (1, FOREIGN):
            return str(code), "neither: foreign"
        return "killed" if code < 0 else str(code), self.judged(code)

    def _state(self, kind: str, moment: int, rng: random.Random) -> Files:
        if moment < self._done:
            self._begin_replay()
        for record in self.records[self._done : moment]:
            self._disk.apply(record)
        self._done = moment
        if kind == REPLAYED[0]:
            return {path: bytes(file.content) for path, file in self._disk.names.items()}
        return self._disk.after_cut(None if kind == REPLAYED[1] else rng)


def drawn(most: int, found: Sequence[Record], rng: random.Random) -> list[int]:
    """Moments among records: all, or those around synchronisations, renames and removals and a sample of the writes."""
    if len(found) < most:
        return list(range(len(found) + 1))
    marked = {k for i, record in enumerate(found) if record.kind in "sruc" for k in (i, i + 1)}
    marked = set(rng.sample(sorted(marked), min(len(marked), most)))
    rest = rng.sample(range(len(found) + 1), max(most - len(marked), most // 4))
    return sorted({*marked, *rest, len(found)})
