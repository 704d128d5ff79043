"""Which recordings a fleet has: paths, folders that are searched, or a table that names arm and time of each."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.files.table import Column, TableSchema, read_table
from mbcacq.recording.run_folder.register import RunKind, kind_of
from mbcacq.report.sources.run_folder import read_run_identity

LISTED = TableSchema(
    "a table of recordings",
    (Column("recording", kind="text"), Column("arm", kind="text", required=False), Column("time", kind="text", required=False)),
)
OF_A_RECORDING = ("cell.yaml", "poses.csv", "centres.csv", "journal.jsonl")  # one of them marks the folder of a recording
READ = {".csv", ".yaml", ".rrd", ".jsonl"}
DATE = re.compile(r"(\d{4})-?(\d{2})-?(\d{2})(?:[T_-](\d{2})[-:h]?(\d{2})(?:[-:m]?(\d{2}))?)?(?!\d)")


@dataclass(frozen=True)
class FleetRecording:
    """One recording. arm: which arm it is of; time: when it was recorded, ISO 8601, '' if that is not known."""

    path: str
    arm: str
    time: str = ""

    @property
    def key(self) -> str:
        """Name of its result's file: readable, and different for different paths."""
        digest = hashlib.sha256(os.fsencode(self.path)).hexdigest()[:12]
        return f"{re.sub('[^A-Za-z0-9._-]+', '_', Path(self.path).name)[:60]}-{digest}"

    def fingerprint(self) -> str:
        """Changes with the names, sizes and times of the files of the recording."""
        path = Path(self.path)
        files = sorted(p for p in path.glob("*") if p.suffix in READ) if path.is_dir() else [path]
        digest = hashlib.sha256()
        for file in files:
            try:
                stat = file.stat()
            except OSError:
                continue  # reading it will say so
            digest.update(f"{file.name}|{stat.st_size}|{stat.st_mtime_ns}\n".encode("utf-8", "surrogateescape"))
        return digest.hexdigest()


def find_recordings(sources: Sequence[Path | str]) -> list[FleetRecording]:
    """The recordings of sources: each a recording, a folder below which recordings are sought, or a CSV table with the column ``recording``
    and, where known, ``arm`` and ``time``.

    Without a table, the arm is the name of the folder in which the recording lies, and the time that of the run's start, or a date in the
    recording's name. Raises ConfigError if a source holds none, or a recording is given twice.
    """
    found: list[FleetRecording] = []
    for source in map(Path, sources):
        if source.suffix.lower() == ".csv" and source.is_file():
            found += listed(source)
        elif not source.exists():
            raise ConfigError(f"{source} does not exist; give recordings, folders of recordings, or a CSV table of them")
        else:
            here = [described(path) for path in sorted(searched(source))]
            if not here:
                raise ConfigError(f"{source} holds no recording (a run folder, a .rrd, an observation set); give another folder")
            found += here
    seen: set[str] = set()
    for one in found:
        if one.path in seen:
            raise ConfigError(f"the recording {one.path} is given twice; give it once")
        seen.add(one.path)
    return found


def searched(source: Path) -> Iterable[Path]:
    """The recordings at and below a path."""
    if source.is_file() or is_recording(source):
        if source.is_file() or kind_of(source) is not RunKind.CHECK:  # few poses at one station are no calibration
            yield source
        return
    for path in source.iterdir():
        if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            yield from searched(path)
        elif path.suffix == ".rrd":
            yield path


def is_recording(folder: Path) -> bool:
    """Whether a folder is that of a recording, be it complete or not."""
    return any((folder / name).exists() for name in OF_A_RECORDING) or any(folder.glob("run*.rrd"))


def described(path: Path) -> FleetRecording:
    """Arm and time of a recording by where it lies and what its run says."""
    path = path.absolute()
    return FleetRecording(str(path), path.parent.name, started(path) or dated(path.stem if path.is_file() else path.name))


def started(path: Path) -> str:
    """When the run of a folder was started, '' if it does not say."""
    return _iso(str(read_run_identity(path).get("started", ""))) if (path / "journal.jsonl").exists() else ""


def dated(name: str) -> str:
    """The date in a name, such as 2026-03-01 or 20260301T0830, as ISO 8601; '' if there is none."""
    for match in DATE.finditer(name):
        year, month, day, hour, minute, second = (int(part or 0) for part in match.groups())
        try:
            return datetime(year, month, day, hour, minute, second, tzinfo=UTC).isoformat()
        except ValueError:
            continue
    return ""


def listed(table: Path) -> list[FleetRecording]:
    """The recordings of a CSV table; relative paths are seen from its folder. Raises ConfigError naming the line of a fault."""
    found = read_table(table, LISTED)
    blank = ("",) * len(found)
    arms, times = (found.text(name) if found.has(name) else blank for name in ("arm", "time"))
    out = []
    for row, (recording, arm, time) in enumerate(zip(found.text("recording"), arms, times, strict=True)):
        if not recording.strip():
            raise ConfigError(f"{found.where(row, 'recording')}: the recording is missing; give its path")
        try:
            one = described(table.absolute().parent / recording.strip())
        except OSError as error:  # a name that no system takes
            where = found.where(row, "recording")
            raise ConfigError(f"{where}: '{recording.strip()[:40]}' is no path ({error.strerror}); give the recording's path") from None
        if time.strip() and not _iso(time.strip()):
            raise ConfigError(f"{found.where(row, 'time')}: '{time.strip()}' is no time; write it as 2026-03-01 or 2026-03-01T08:30:00")
        out.append(replace(one, arm=arm.strip() or one.arm, time=_iso(time.strip()) or one.time))
    return out


def _iso(text: str) -> str:
    """A time as ISO 8601 with its zone (UTC where none is said); '' if it is none."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        return ""
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).isoformat()
