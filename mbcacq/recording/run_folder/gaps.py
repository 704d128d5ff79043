"""Gaps of a run's recording as sentences, so that no gap is silent."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

from mbcacq.errors import MbcacqError
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import open_recordings
from mbcacq.recording.run_folder.journal import read_journal

NAMED = 12  # pose numbers written out
MOST_POSES = 1_000_000  # a journal that says more is damaged


def find_gaps(folder: Path | str) -> list[str]:
    """One sentence for each gap of a run folder or recording: poses left out, damaged or never reached, values missing, interruptions.

    Empty for an undisturbed run and for data that are no recording.
    """
    folder = Path(folder)
    held, damaged = _recorded(folder)
    if not (folder / layout.JOURNAL_FILE).exists():
        return _damage(damaged)
    entries = read_journal(folder)
    measured = _values(entries, "pose_done", "pose")
    planned = max(_values(entries, "run_started", "n_poses"), default=0)
    out = [
        str(e.get("text", "")) for e in entries if e.get("event") == "gap" and not (e.get("kind") == "pose" and e.get("pose") in measured)
    ]  # measured when resumed
    left_out = _values([e for e in entries if e.get("kind") == "pose"], "gap", "pose")
    if missing := sorted(set(range(planned)) - measured - left_out):
        out.append(f"{len(missing)} of {planned} planned poses were not measured: {_numbers(missing)}")
    lost = set() if held is None else measured - held
    return out + _damage(damaged | lost) + _interruptions(entries)


def _values(entries: list[dict[str, Any]], event: str, key: str) -> set[int]:
    """The numbers that the entries of an event have under a key; what cannot be a number of poses is no number."""
    found = (entry.get(key) for entry in entries if entry.get("event") == event)
    return {value for value in found if isinstance(value, int) and 0 <= value <= MOST_POSES}


def _recorded(path: Path) -> tuple[set[int] | None, set[int]]:
    """Numbers of the poses that the recordings of a run folder, or a .rrd, hold intact (None if they cannot be read), and damaged."""
    if not (path.suffix == ".rrd" or path.is_dir() and layout.parts(path)):
        return None, set()
    try:
        recordings = open_recordings(path)
        held = {int(row["pose"][0]) for recording in recordings for row in recording.observed()}
        return held, {number for recording in recordings for number in recording.damaged_poses()} - held
    except MbcacqError:
        return None, set()  # who reads the observations is told


def _damage(poses: set[int]) -> list[str]:
    if not poses:
        return []
    many = f"pose {min(poses)} was" if len(poses) == 1 else f"{len(poses)} poses ({_numbers(sorted(poses))}) were"
    return [f"{many} measured, but the recording holds no intact values (see mbcacq recover --check); a resumed run measures anew"]


def _interruptions(entries: list[dict[str, Any]]) -> list[str]:
    """One sentence for each interruption, and one for all the times that poses were added to a run whose poses were all measured."""
    out: list[str] = []
    added: list[str] = []
    last, done = None, set()
    for before, now in pairwise(entries):
        if before.get("event") == "pose_done":
            last = before.get("pose")
            done.add(last)
        if now.get("event") == "run_started":
            if before.get("event") == "run_stopped" and before.get("exit_status") == "success":
                added.append(str(last))
                continue
            why = before.get("reason", "") if before.get("event") == "run_stopped" else "it was killed"
            where = (
                "before its first pose" if last is None else f"after {len(done)} pose{'s' * (len(done) != 1)}, the last of them pose {last}"
            )
            out.append(f"the run was interrupted {where} ({why}) and went on at {now.get('started', 'an unknown time')}")
    return [*out, f"poses were added to the run after pose {', '.join(added)}"] if added else out


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:NAMED]))
    return shown + ("..." if len(numbers) > NAMED else "")
