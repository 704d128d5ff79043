"""The journal of a run, one JSON object a line, each on the disk before the run goes on; and the log, the same way. Every line carries a
checksum."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from datetime import UTC, datetime
from functools import singledispatchmethod
from pathlib import Path
from typing import Any, BinaryIO

from mbcacq.acquisition import events
from mbcacq.errors import RecordingError
from mbcacq.files.atomic_write import inside_folder, sync_folder
from mbcacq.model.cell import SIMULATED
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checked_lines import checked_line, read_lines


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

    @singledispatchmethod
    def _write(self, event: events.Event) -> None:
        pass

    @_write.register
    def _(self, event: events.RunStarted) -> None:
        entry = {"name": event.name, "started": event.started, "n_poses": event.n_poses, "versions": dict(event.versions)}
        self._write_journal(event.time_s, event="run_started", **entry, **({"simulated": True} if event.simulated else {}))
        if event.simulated:
            self._write_log(event, "warning", "mbcacq", SIMULATED)

    @_write.register
    def _(self, event: events.DeviceConnected) -> None:
        about = event.about
        known = {"model": about.model, "serial": about.serial, "firmware": about.firmware, "settings": dict(about.settings)}
        fields = [f"{field.name} [{field.unit}]" for field in about.fields]
        self._write_journal(event.time_s, event="device", role=event.role, driver=event.driver, **known, fields=fields)

    @_write.register
    def _(self, event: events.PoseDone) -> None:
        self._write_journal(
            event.time_s,
            event="pose_done",
            pose=event.pose,
            station=event.station,
            phase=event.phase,
            step=event.step,
            balls=len(event.ball),
            robot_time_s=float(event.robot_time_s),
            **({"facts": dict(event.facts)} if event.facts else {}),
        )

    @_write.register
    def _(self, event: events.FactChanged) -> None:
        self._write_journal(event.time_s, event="fact", role=event.role, name=event.name, before=event.before, now=event.now)

    @_write.register
    def _(self, event: events.Gap) -> None:
        self._write_journal(event.time_s, event="gap", kind=event.kind, text=event.text, pose=event.pose)

    @_write.register
    def _(self, event: events.RunStopped) -> None:
        self._write_journal(event.time_s, event="run_stopped", exit_status=event.exit_status, reason=event.reason)
        self._write_log(
            event, "info" if event.exit_status == "success" else "error", "mbcacq", f"run ended: {event.exit_status}: {event.reason}"
        )

    @_write.register
    def _(self, event: events.Message) -> None:
        self._write_log(event, event.level, event.source, event.text)

    @_write.register
    def _(self, event: events.StepStarted) -> None:
        self._write_log(event, "info", "mbcacq", f"step {event.name} ({event.n_poses} poses)")

    @_write.register
    def _(self, event: events.StationReached) -> None:
        self._write_log(event, "info", "mbcacq", f"artefact {event.artefact} at station {event.station}")

    def _write_journal(self, time_s: float, **entry: Any) -> None:
        self._append(self._journal, layout.JOURNAL_FILE, {"time_s": round(time_s, 4), **entry}, sync=True)

    def _write_log(self, event: events.Event, level: str, source: str, text: str) -> None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        entry = {"time": now, "time_s": round(event.time_s, 4), "level": level, "source": source, "text": text}
        self._append(self._log, layout.LOG_FILE, entry)

    def _append(self, file: BinaryIO, name: str, entry: dict[str, Any], sync: bool = False) -> None:
        try:
            file.write(checked_line(entry))
            file.flush()
            if sync:
                os.fsync(file.fileno())
        except OSError as error:
            raise RecordingError(f"{name} can no longer be written: {error.strerror}; free the disk and resume the run") from error


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
    path = inside_folder(path)
    torn = path.exists() and path.stat().st_size > 0 and path.read_bytes()[-1:] != b"\n"
    file = path.open("ab")
    if torn:
        file.write(b"\n")
    return file
