"""Torn recordings made readable: everything complete before the tear, with a new footer, in a copy. The original stays as it is."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.files.atomic_write import fresh, publish
from mbcacq.model.json_text import FilePath
from mbcacq.recording.rrd import layout, rerun_program
from mbcacq.recording.rrd.checksums import blocks, digest_of_file, note_made, read_stretches
from mbcacq.recording.rrd.reader import Recording, opened, opened_once
from mbcacq.recording.run_folder.lock import LOCK_FILE, write_lock

WHOLE = "whole.rrd"


@dataclass(frozen=True)
class Recovered:
    """source: the recording as found. output: the readable copy, or the source itself where nothing was wrong with it.

    poses: finished poses in it; cycles: controller cycles; complete: whether the run's end is in it.
    """

    source: FilePath
    output: FilePath
    poses: int
    cycles: int
    complete: bool

    @property
    def damaged(self) -> bool:
        return self.output != self.source


class NothingRecovered(RecordingError):
    """A recording holds nothing that can be calibrated; no other copy of it does."""


def recover(path: Path | str) -> list[Recovered]:
    """Make a .rrd, or every recording of a run folder, readable. Raises RecordingError if nothing is left to read.

    A damaged NAME.rrd is copied to NAME.recovered.rrd (never overwriting one), which ``load_observations`` then prefers. A run of several
    parts is also merged into whole.rrd. Raises RecordingError if another process writes in the run folder.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    if folder != path and not ((folder / LOCK_FILE).exists() or (folder / layout.JOURNAL_FILE).exists()):
        return make_readable(path)  # a file in no run folder
    with write_lock(folder, "recover"):
        return make_readable(path)


def make_readable(path: Path) -> list[Recovered]:
    """``recover`` for one who holds the lock of the run folder."""
    try:
        with opened_once():
            return _made_readable(path)
    except RecordingError:
        raise
    except OSError as error:
        where = error.filename or path
        raise RecordingError(f"{where} cannot be written: {error.strerror}; give another folder or free the disk") from error


def _made_readable(path: Path) -> list[Recovered]:
    if path.is_dir():
        sources = layout.originals(path)
        if not sources:
            raise ConfigError(f"{path} holds no recording (run.rrd); give the folder of a run, or a .rrd file")
        found = [_recover_file(source) for source in sources]
        if len(found) > 1:
            _merge([item.output for item in found], path / WHOLE)
        return found
    if not path.is_file():
        raise ConfigError(f"{path} does not exist; give the folder of a run, or a .rrd file")
    return [_recover_file(path)]


def _recover_file(source: Path) -> Recovered:
    if not source.is_file():  # rerun's program would read a folder without end
        raise NothingRecovered(f"{_nothing([source])}: it is no file, or a link that leads to none")
    if source.stat().st_size == 0:
        raise NothingRecovered(f"{_nothing([source])}: it is empty, nothing was ever written into it")
    if _verified(source):
        return _summary(source, source)
    existing = layout.recovered_of(source)
    if existing is not None and existing.stat().st_mtime >= source.stat().st_mtime and _verified(existing):
        return _summary(source, existing)
    output = layout.next_recovered(source)
    try:
        _merge_what_is_whole(source, output)
        return _summary(source, output)
    except NothingRecovered:
        output.unlink(missing_ok=True)
        raise


def _merge_what_is_whole(source: Path, output: Path) -> None:
    """Merge a recording; one that rerun cannot read to its end without the stretches that are not as they were written."""
    try:
        _merge([source], output)
    except NothingRecovered:
        stretches = read_stretches(source.parent)[0].get(source.name, [])
        whole = [stretch for stretch in stretches if digest_of_file(source, stretch.start, stretch.end) == (stretch.sha256, stretch.end)]
        if len(whole) == len(stretches) or stretches[0] not in whole:
            raise  # nothing is known to be damaged, or what all else refers to is
        cut = fresh(source.with_name(f".{source.stem}.whole.rrd"))
        try:
            with source.open("rb") as original, cut.open("wb") as copy:
                for stretch in whole:
                    original.seek(stretch.start)
                    for block in blocks(original, stretch.end - stretch.start):
                        copy.write(block)
            _merge([cut], output)
        finally:
            cut.unlink(missing_ok=True)


def _merge(sources: list[Path], output: Path) -> None:
    """Merge through a temporary name, so that a broken merge leaves nothing behind."""
    size = sum(source.stat().st_size for source in sources)
    free = shutil.disk_usage(output.parent).free
    if free < size + (16 << 20):
        raise RecordingError(f"the copy needs {size >> 20} MiB, only {free >> 20} MiB are free in {output.parent}; free some space")
    partial = fresh(output.with_name(f".{output.stem}.part.rrd"))
    try:
        result = rerun_program.run(["rrd", "merge", "--continue-on-error", *map(str, sources), "-o", str(partial)])
        if result.returncode or not partial.exists():
            raise NothingRecovered(f"{_nothing(sources)}: rerun could not read it ({rerun_program.error_line(result)})")
        if not _verified(partial, Recording):  # closed again: Windows renames no open file
            raise NothingRecovered(f"{_nothing(sources)}: no complete message is left in it")
        note_made(partial, output)
        publish(partial, output)
    finally:
        partial.unlink(missing_ok=True)


def _nothing(sources: list[Path]) -> str:
    return f"nothing could be recovered from {', '.join(map(str, sources))}"


def _verified(path: Path, open_recording: Callable[[Path], Recording] = opened) -> bool:
    """Whether rerun's own check finds no fault, and our reader all that there is to read."""
    if rerun_program.run(["rrd", "verify", str(path)]).returncode:
        return False
    try:
        recording = open_recording(path)
        for read in (recording.about, recording.observed, recording.cycles):
            read()
    except RecordingError:
        return False
    return True


def _summary(source: Path, output: Path) -> Recovered:
    recording = opened(output)
    try:
        recording.text(layout.CELL)
    except RecordingError as error:  # whole as a file, but cut before its cell was in it
        raise NothingRecovered(f"{_nothing([source])}: {error}") from None
    about = recording.about()
    poses = {int(row["pose"][0]) for row in recording.observed()}
    return Recovered(source, output, len(poses), len(recording.cycles()), "exit_status" in about)
