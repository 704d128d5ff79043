"""The journal of a run, one JSON object a line, each on the disk before the run goes on; and the log, the same way. Every line carries a
checksum."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from mbcacq.acquisition import events
from mbcacq.errors import RecordingError
from mbcacq.files.atomic_write import own_file, sync_folder
from mbcacq.model.cell import SIMULATED
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checked_lines import checked_line, read_lines

AS_THEY_ARE = {
    events.FactChanged: ("fact", ("role", "name", "before", "now")),
    events.Gap: ("gap", ("kind", "text", "pose")),
    events.RunStopped: ("run_stopped", ("exit_status", "reason")),
}


class Journal:
    """Event subscriber: ``journal.jsonl`` (run started, devices, pose done, gap, run stopped; fsync each), ``log.jsonl`` (messages)."""

    def __init__(self, folder: Path | str) -> None:
        folder = Path(folder)
        self._lock = threading.Lock()
        try:
            self._journal = _open(folder / layout.JOURNAL_FILE)
            self._log = _open(folder / layout.LOG_FILE)
            sync_folder(folder)
        except OSError as error:
            raise RecordingError(f"{folder / layout.JOURNAL_FILE} cannot be written: {error.strerror}; choose another --out") from error

    def __call__(self, event: events.Event) -> None:
        with self._lock:
            self._write(event)

    def close(self) -> None:
        with self._lock:
            for file in (self._journal, self._log):
                with suppress(OSError):  # what a full disk did not take was reported when it was written
                    file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, event: events.Event) -> None:
        if (noted := _noted(event)) is not None:
            name, entry = noted
            self._append(self._journal, layout.JOURNAL_FILE, {"time_s": round(event.time_s, 4), "event": name, **entry}, sync=True)
        if (said := _said(event)) is not None:
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            entry = {"time": now, "time_s": round(event.time_s, 4), **dict(zip(("level", "source", "text"), said, strict=True))}
            self._append(self._log, layout.LOG_FILE, entry)

    def _append(self, file: BinaryIO, name: str, entry: dict[str, Any], sync: bool = False) -> None:
        try:
            file.write(checked_line(entry))
            file.flush()
            if sync:
                os.fsync(file.fileno())
        except OSError as error:
            raise RecordingError(f"{name} can no longer be written: {error.strerror}; free the disk and resume the run") from error


def _noted(event: events.Event) -> tuple[str, dict[str, Any]] | None:
    """What the journal keeps of an event: its name and its facts."""
    match event:
        case events.RunStarted():
            simulated = {"simulated": True} if event.simulated else {}
            return "run_started", {**_of(event, "name", "started", "n_poses"), "versions": dict(event.versions), **simulated}
        case events.DeviceConnected(about=about):
            known = {**_of(about, "model", "serial", "firmware"), "settings": dict(about.settings)}
            return "device", {**_of(event, "role", "driver"), **known, "fields": [f"{field.name} [{field.unit}]" for field in about.fields]}
        case events.PoseDone():
            measured = {"balls": len(event.ball), "robot_time_s": float(event.robot_time_s)}
            facts = {"facts": dict(event.facts)} if event.facts else {}
            return "pose_done", {**_of(event, "pose", "station", "phase", "step"), **measured, **facts}
    name, facts = AS_THEY_ARE.get(type(event), ("", ()))
    return (name, _of(event, *facts)) if name else None


def _said(event: events.Event) -> tuple[str, str, str] | None:
    """What the log says of an event: level, source and text."""
    match event:
        case events.RunStarted(simulated=True):
            return "warning", "mbcacq", SIMULATED
        case events.RunStopped(exit_status=status):
            return "info" if status == "success" else "error", "mbcacq", f"run ended: {status}: {event.reason}"
        case events.Message():
            return event.level, event.source, event.text
        case events.StepStarted():
            return "info", "mbcacq", f"step {event.name} ({event.n_poses} poses)"
        case events.StationReached():
            return "info", "mbcacq", f"artefact {event.artefact} at station {event.station}"
    return None


def _of(source: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(source, name) for name in names}


def read_journal(folder: Path | str) -> list[dict[str, Any]]:
    """The entries of a run folder's journal; torn and damaged lines are left out. Raises RecordingError if there is none."""
    path = Path(folder) / layout.JOURNAL_FILE
    try:
        return read_lines(path).entries
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}; is this a run folder?") from None


def recorded_facts(folder: Path | str) -> dict[str, str]:
    """What the devices reported of themselves at the first measured pose of a run, e.g. ``{"robot load": "2.3 kg"}``; empty if that was
    not recorded."""
    try:
        entries = read_journal(folder)
    except RecordingError:
        return {}
    found: dict[str, str] = {}
    for entry in entries:
        if entry.get("event") == "pose_done" and isinstance(facts := entry.get("facts"), dict):
            found = {str(name): str(value) for name, value in facts.items()} | found
    return found


def read_log(folder: Path | str) -> list[dict[str, Any]]:
    """The entries of a run folder's log, none where it has no log; torn and damaged lines are left out."""
    try:
        return read_lines(Path(folder) / layout.LOG_FILE).entries
    except OSError:
        return []


def _open(path: Path) -> BinaryIO:
    """Open for appending; a torn last line left by a crash is ended first, so that it spoils no other."""
    path = own_file(path)
    torn = path.exists() and path.stat().st_size > 0 and path.read_bytes()[-1:] != b"\n"
    file = path.open("ab")
    if torn:
        file.write(b"\n")
    return file
