"""Whether the files of a run are as they were written: every bit that has a checksum, and what a changed one hits. Nothing is written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.model.json_text import unsealed
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checked_lines import read_lines
from mbcacq.recording.rrd.checksums import FILE, Stretch, digest_of_file, is_version, read_stretches, read_versions
from mbcacq.recording.rrd.reader import opened
from mbcacq.recording.rrd.run_header import FILE as HEADER_FILE
from mbcacq.recording.run_folder.lock import write_lock
from mbcacq.recording.run_folder.run_plan import FILES, PLAN

LINES = (layout.JOURNAL_FILE, layout.LOG_FILE, FILE)
WHOLE_FILES = (PLAN, FILES, HEADER_FILE)
RESULT = "result.json"
COMPUTED = (layout.RESULT_FILE, layout.DIAGNOSIS_FILE, "diagnosis.json", "diagnosis-pictures.json")  # which one may delete


@dataclass(frozen=True)
class CheckedFile:
    """faults: one sentence each. size: bytes; unverified: how many of them have no checksum."""

    path: Path
    size: int
    unverified: int
    faults: tuple[str, ...]


def check(path: Path | str) -> list[CheckedFile]:
    """Check a run folder or one of its recordings against the checksums that were noted when they were written.

    Raises ConfigError if there is no recording, RecordingError if another process writes in the folder.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    recordings = layout.originals(folder) if path.is_dir() else [path]
    if not recordings or not all(recording.is_file() for recording in recordings):
        raise ConfigError(f"{path} holds no recording (run.rrd); give the folder of a run, or a .rrd file")
    with write_lock(folder, "recover --check"):
        stretches = read_stretches(folder)[0]
        found = [_check_recording(recording, stretches.get(recording.name, [])) for recording in recordings]
        if path.is_dir():
            found += [_check_lines(folder / name) for name in LINES if (folder / name).exists()]
            found += [
                _check_whole(folder / name, stretches.get(name, []))
                for name in WHOLE_FILES
                if name in stretches or (folder / name).exists()
            ]
            versions = read_versions(folder)
            found += [_check_made(folder / name, versions[name]) for name in COMPUTED if name in versions and (folder / name).exists()]
            found += [_check_result(folder / RESULT)] if (folder / RESULT).exists() else []
        return found


def _check_recording(path: Path, stretches: list[Stretch]) -> CheckedFile:
    size = path.stat().st_size
    faults = [*_stretch_faults(path, stretches, size), *_value_faults(path)]
    return CheckedFile(path, size, size - sum(min(s.end, size) - min(s.start, size) for s in stretches), tuple(faults))


def _stretch_faults(path: Path, stretches: list[Stretch], size: int) -> Iterator[str]:
    for stretch in stretches:
        poses = f" (with pose {', '.join(map(str, stretch.poses))})" if stretch.poses else ""
        where = f"bytes {stretch.start} to {stretch.end}{poses}"
        try:
            digest, end = digest_of_file(path, stretch.start, stretch.end)
        except OSError as error:
            yield f"{where} cannot be read: {error.strerror}"
            continue
        if end < stretch.end:
            yield f"{where} were written, but the file ends at byte {size}"
        elif digest != stretch.sha256:
            yield f"{where} are not as they were written"


def _value_faults(path: Path) -> Iterator[str]:
    """Faults of the values that a solver reads, by name."""
    try:
        recording = opened(path)
        for entity in (layout.PLAN, layout.CELL):
            try:
                recording.text(entity)
            except RecordingError as error:
                yield str(error)
        for number in recording.damaged_poses():
            yield f"the observation of pose {number} (joint angles, ball centres) is not as it was written"
        if damaged := recording.damaged_cycles():
            yield f"batches of controller cycles that are not as they were written: {damaged}; the others are read"
    except RecordingError as error:
        yield f"it cannot be read as a recording: {error}"


def _check_lines(path: Path) -> CheckedFile:
    size = path.stat().st_size
    return CheckedFile(path, size, 0, tuple(f"line {number} is torn or not as it was written" for number in read_lines(path).damaged))


def _check_whole(path: Path, stretches: list[Stretch]) -> CheckedFile:
    if not path.exists():
        return CheckedFile(path, 0, 0, ("it is missing",))
    size = path.stat().st_size
    if not stretches:
        return CheckedFile(path, size, size, ())
    same = size == stretches[-1].end and digest_of_file(path, 0, size)[0] == stretches[-1].sha256
    return CheckedFile(path, size, 0, () if same else ("it is not as it was written",))


def _check_made(path: Path, versions: list[Stretch]) -> CheckedFile:
    """A file that is made anew as a whole is the last one noted, or an earlier one where the last never took its name."""
    return CheckedFile(path, path.stat().st_size, 0, () if is_version(path, versions) else ("it is not as it was written",))


def _check_result(path: Path) -> CheckedFile:
    """It carries its own checksum, since it is copied elsewhere."""
    size, faults = path.stat().st_size, ()
    try:
        unsealed(json.loads(path.read_bytes()), path)
    except (ValueError, RecursionError):
        faults = ("it is not as it was written",)
    return CheckedFile(path, size, 0, faults)
