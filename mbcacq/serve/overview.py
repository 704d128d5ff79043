"""What a list and a page say of a run: the words and figures of page one of its report, or what is wrong with its files."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mbcacq.errors import MbcacqError
from mbcacq.exports.result_json import load_result
from mbcacq.recording.run_folder.register import CHECK_RESULT, RunKind, kind_of
from mbcacq.recording.run_folder.run_plan import FILES as PLAN_FILES
from mbcacq.report.content import Content
from mbcacq.report.sources.check_result import read_check_result
from mbcacq.report.sources.from_result import content_of
from mbcacq.report.sources.run_folder import read_kept_findings, read_run_identity

FILES = ("result.json", "diagnosis.json", "with-effects/result.json", "journal.jsonl", CHECK_RESULT, PLAN_FILES)
MOST_KEPT = 300
MOST_BYTES = 64 << 20  # of one of these files; a result has a few


@dataclass(frozen=True)
class Overview:
    """One run with its result, for the pages.

    Attributes
    ----------
    content : Content or None
        Content of the report, None where the run has no result.
    damaged : str
        What is wrong with a file of it, or ''.
    best : Mapping[str, Any]
        The result that the content is about, {} for none.
    started : str
        Date and time (UTC) of the recording, as text.
    simulated : bool
        The result is of simulated data.
    kind : RunKind
        What was recorded.
    check : Mapping[str, Any] or None
        What a check said, None where there is none or it was not judged.
    """

    content: Content | None = None
    damaged: str = ""
    best: Mapping[str, Any] = field(default_factory=dict)
    started: str = ""
    simulated: bool = False
    kind: RunKind = RunKind.RUN
    check: Mapping[str, Any] | None = None


class Overviews:
    """The overview of each run, read again where one of its files has changed; the last few hundred are kept. For several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[Path, tuple[object, Overview]] = {}

    def of(self, folder: Path) -> Overview:
        stamp = tuple(_stamp(folder / name) for name in FILES)
        with self._lock:
            kept = self._kept.get(folder)
        if kept is not None and kept[0] == stamp:
            return kept[1]
        read = read_overview(folder)
        with self._lock:
            self._kept.pop(folder, None)
            self._kept[folder] = (stamp, read)
            while len(self._kept) > MOST_KEPT:
                del self._kept[next(iter(self._kept))]
        return read


def read_overview(folder: Path) -> Overview:
    """The overview of a run. Damaged files are said, not raised; nothing is written."""
    identity = read_run_identity(folder)
    started = f"{identity['started'][:16].replace('T', ' ')} UTC" if identity.get("started") else ""
    content: Content | None = None
    best: Mapping[str, Any] = {}
    kind, check = kind_of(folder), None
    try:
        for name in FILES:
            if (folder / name).is_file() and (folder / name).stat().st_size > MOST_BYTES:
                return Overview(damaged=f"{name} is larger than {MOST_BYTES >> 20} MB, and no file of its kind is", started=started)
        if (folder / CHECK_RESULT).exists():
            check = read_check_result(folder)
        if (folder / "result.json").exists():
            geometry = load_result(folder / "result.json")
            found = read_kept_findings(folder)
            content = content_of(geometry, None, {**identity, **found, "folder": str(folder), "name": folder.name})
            best = found.get("with_effects", geometry)
    except (MbcacqError, OSError, LookupError, TypeError, ValueError, RecursionError) as error:
        said = str(error) if isinstance(error, MbcacqError) else "a file of it is damaged; write it anew with mbcacq report"
        return Overview(damaged=said, started=started, kind=kind)
    simulated = bool(best.get("simulated") or (check or {}).get("simulated"))
    return Overview(content, "", best, started, simulated, kind, check)


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
