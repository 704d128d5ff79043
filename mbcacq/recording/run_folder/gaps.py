"""Gaps of a run's recording as sentences, so that no gap is silent."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

from mbcacq.recording.rrd import layout
from mbcacq.recording.run_folder.journal import read_journal

NAMED = 12  # pose numbers written out


def find_gaps(folder: Path | str) -> list[str]:
    """One sentence for each gap of a run folder: poses left out or never reached, values missing, interruptions.

    Empty for an undisturbed run and for data without a journal.
    """
    folder = Path(folder)
    if not (folder / layout.JOURNAL_FILE).exists():
        return []
    entries = read_journal(folder)
    measured = {int(e["pose"]) for e in entries if e.get("event") == "pose_done"}
    planned = max((int(e["n_poses"]) for e in entries if e.get("event") == "run_started"), default=0)
    out = [e["text"] for e in entries if e.get("event") == "gap" and not _measured_later(e, measured)]
    left_out = {int(e["pose"]) for e in entries if e.get("event") == "gap" and e.get("kind") == "pose"}
    if missing := sorted(set(range(planned)) - measured - left_out):
        out.append(f"{len(missing)} of {planned} planned poses were not measured: {_numbers(missing)}")
    return out + _interruptions(entries)


def _measured_later(entry: dict[str, Any], measured: set[int]) -> bool:
    """Whether the entry is a pose that was left out and then measured when the run was resumed."""
    return entry.get("kind") == "pose" and entry.get("pose") in measured


def _interruptions(entries: list[dict[str, Any]]) -> list[str]:
    out, last = [], None
    for before, now in pairwise(entries):
        if before.get("event") == "pose_done":
            last = int(before["pose"])
        if now.get("event") == "run_started":
            why = before.get("reason", "") if before.get("event") == "run_stopped" else "it was killed"
            where = "before its first pose" if last is None else f"after pose {last}"
            out.append(f"the run was interrupted {where} ({why}) and went on at {now.get('started', 'an unknown time')}")
    return out


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:NAMED]))
    return shown + ("..." if len(numbers) > NAMED else "")
