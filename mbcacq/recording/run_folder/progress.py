"""Progress of an interrupted run: which poses are measured and readable. Resuming goes on from here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import open_recordings, opened, opened_once
from mbcacq.recording.rrd.run_header import RunHeader, read_run_header, write_run_header
from mbcacq.recording.run_folder.journal import read_journal
from mbcacq.recording.run_folder.recovery import NothingRecovered, make_readable

EMPTY = ".empty"  # added to the name of a recording in which nothing can be read


@dataclass(frozen=True)
class Progress:
    """done: numbers of the poses that need not be measured again. part: number of the recording to write next.

    stations: station -> numbers of its measured poses. repairs: one sentence for each recording that had to be repaired.
    """

    done: frozenset[int]
    part: int
    stations: dict[str, tuple[int, ...]]
    repairs: tuple[str, ...] = ()


def poses_done(folder: Path | str) -> frozenset[int]:
    """Numbers of the poses that the journal of a run folder lists and its recordings hold.

    After a power cut the journal can be ahead of the recording; such a pose is measured again. Raises RecordingError if there is
    no journal or a recording is torn (``mbcacq recover`` makes it readable).
    """
    return frozenset(_measured(Path(folder)))


def repair_and_read_progress(folder: Path | str) -> Progress:
    """Make every recording of an interrupted run readable and return what they hold. Nothing is deleted: a torn recording stays next to
    its recovered copy, one without content gets another name. Raises RecordingError if the disk does not take the copy."""
    folder = Path(folder)
    with opened_once():
        repairs = tuple(_repair(folder))
        _keep_identity(folder)
        measured = _measured(folder) if (folder / layout.JOURNAL_FILE).exists() else {}
    stations: dict[str, tuple[int, ...]] = {}
    for number, station in sorted(measured.items()):
        stations[station] = (*stations.get(station, ()), number)
    return Progress(frozenset(measured), layout.next_part(folder), stations, repairs)


def _measured(folder: Path) -> dict[int, str]:
    """Number -> station."""
    entries = read_journal(folder)
    listed = {entry["pose"] for entry in entries if entry.get("event") == "pose_done" and isinstance(entry.get("pose"), int)}
    try:
        recordings = open_recordings(folder) if layout.parts(folder) else []
    except ConfigError as error:
        raise RecordingError(str(error)) from None
    rows = [row for recording in recordings for row in recording.observed()]
    return {int(row["pose"][0]): str(row["station"][0]) for row in rows if int(row["pose"][0]) in listed}


def _repair(folder: Path) -> Iterator[str]:
    for path in layout.parts(folder):
        try:
            recording = opened(path)
            recording.observed()
            recording.text(layout.CELL)
            continue
        except RecordingError:
            pass
        try:
            found = make_readable(path)[0]
            yield f"{path.name} was torn or damaged; its {found.poses} finished poses are in {found.output.name}"
        except NothingRecovered:
            path.rename(path.with_name(path.name + EMPTY))
            yield f"no pose can be read in {path.name}: it is now {path.name + EMPTY}, and its poses are measured again"


def _keep_identity(folder: Path) -> None:
    """All parts carry one recording id; where the note of it was lost, it is taken from the first part."""
    parts = layout.parts(folder)
    if parts and read_run_header(folder) is None:
        first = opened(parts[0])
        about = first.about()
        write_run_header(folder, RunHeader(first.recording_id, str(about["started"]), str(about["name"])))
