"""``recording.json`` of a run folder: what a resumed run needs to become part of the same recording."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from mbcacq.files.atomic_write import write_file
from mbcacq.recording.rrd.checksums import note_whole

FILE = "recording.json"


@dataclass(frozen=True)
class RunHeader:
    """recording_id: of all parts; started: ISO 8601 UTC, when the first part began."""

    recording_id: str
    started: str
    name: str


def write_run_header(folder: Path, header: RunHeader) -> None:
    data = (json.dumps({"format": "mbcacq-run/1", **asdict(header)}, indent=1) + "\n").encode("utf-8")
    write_file(folder / FILE, data)
    note_whole(folder, FILE, data)


def read_run_header(folder: Path) -> RunHeader | None:
    """None if there is none or it is torn; the resumed part is then a recording of its own."""
    try:
        data = json.loads((folder / FILE).read_text(encoding="utf-8"))
        return RunHeader(str(data["recording_id"]), str(data["started"]), str(data["name"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
