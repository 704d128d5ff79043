"""The folder of a fleet: one file for each recording, written as results come, and the table of all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pyarrow import Table, parquet
from pyarrow.lib import ArrowException

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file, write_files
from mbcacq.fleet.evaluation import FORMAT, FleetTask
from mbcacq.fleet.recordings import FleetRecording
from mbcacq.fleet.row import FAILED, FleetRow, arrow_schema
from mbcacq.model.json_text import damage, sealed_text, unsealed
from mbcacq.version import __version__

TABLE, PAGE, RECORDINGS = "fleet.parquet", "fleet.html", "recordings"


@dataclass(frozen=True)
class StoredResult:
    """What came of a recording. row: of the table; text: of its file, UTF-8, empty where the file is written."""

    row: FleetRow
    text: bytes


def stored_result(row: FleetRow, content: Mapping[str, Any], stamp: str) -> StoredResult:
    """row, content: as ``evaluate_recording`` gives them. stamp: of the recording before it was read."""
    return StoredResult(row, sealed_text({"format": FORMAT, **content, "row": row.columns(), "stamp": stamp}).encode())


class FleetStore:
    """Results in a folder. A result counts while recording, task and version of the program are what they were, and its checksum holds.

    damaged: files of results whose content is damaged, which do not count.
    """

    def __init__(self, folder: Path, task: FleetTask):

        tried = Path(task.verify).read_bytes() if task.verify and Path(task.verify).is_file() else b""
        self.damaged: list[Path] = []
        self.folder, self.task = folder, hashlib.sha256(f"{__version__}|{task!r}|".encode() + tried).hexdigest()
        try:
            (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder} cannot be made ({error.strerror}); give another --out") from error

    def path(self, recording: FleetRecording) -> Path:
        return self.folder / RECORDINGS / f"{recording.key}.json"

    def stamp(self, recording: FleetRecording) -> str:
        """What a result is valid for."""
        return hashlib.sha256(f"{self.task}|{recording.fingerprint()}".encode()).hexdigest()

    def row(self, recording: FleetRecording) -> FleetRow | None:
        """The row of a recording that is done; None where it is not, is damaged, has changed since, or failed for no fault of its own."""
        path = self.path(recording)
        try:
            content = unsealed(json.loads(path.read_bytes()), path)
            if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("stamp") != self.stamp(recording):
                return None
            row = FleetRow.of_columns(content["row"] | {"arm": recording.arm, "time": recording.time or None})
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError):  # ConfigError of a checksum is a ValueError
            if path not in self.damaged:
                self.damaged.append(path)
            return None
        return None if row.status == FAILED else row

    def keep(self, recording: FleetRecording, outcome: StoredResult) -> FleetRow:
        """Write a result, in one step; its row. Raises RecordingError."""

        write_file(self.path(recording), outcome.text, folder=self.folder)
        return outcome.row

    def write(self, rows: Sequence[FleetRow], page: str) -> tuple[Path, Path]:
        """All rows as one Parquet table, in the order given, and the page about them (HTML), as a set. Raises RecordingError."""

        def table(partial: Path) -> None:
            parquet.write_table(Table.from_pylist([row.columns() for row in rows], schema=arrow_schema(rows)), partial)

        written = write_files(self.folder, {TABLE: table, PAGE: page})
        return written[0], written[1]


def read_table(fleet: Path) -> list[FleetRow]:
    """The rows of a fleet: of its folder, or of its Parquet table. Raises ConfigError."""
    path = fleet / TABLE if fleet.is_dir() else fleet
    try:
        rows = parquet.read_table(path).to_pylist()
    except (OSError, ArrowException, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as the table of a fleet ({error}); give what mbcacq fleet wrote") from error
    needed = {"recording", "arm", "robot", "time", "status", "names", "covariance", "nominal"}
    if not rows or not needed <= set(rows[0]):
        raise ConfigError(f"{path} is no table of a fleet; give what mbcacq fleet wrote")
    out = []
    for number, columns in enumerate(rows, 1):
        try:
            out.append(FleetRow.of_columns(columns))
        except ValueError as error:
            raise ConfigError(f"{path}: row {number} is damaged ({damage(error)}); evaluate the fleet anew") from error
    return out
