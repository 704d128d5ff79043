"""How far a run is, from its journal and its log, whether or not it still goes on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbcacq.model.json_text import AsJson
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checked_lines import read_last_lines
from mbcacq.recording.run_folder.lock import holds_lock, lock_owner

JOURNAL_BYTES, LOG_BYTES = 16 << 20, 64 << 10
LOG_LINES = 200


@dataclass(frozen=True)
class LiveProgress(AsJson):
    """How far a run is.

    Attributes
    ----------
    state : str
        'running'; 'uncertain' (a process left its name, and this system cannot say whether it still runs); 'ended' (all poses were
        measured); 'stopped' (ended early, ``reason`` says why); 'broken off' (the journal just ends); 'none' (nothing was run here).
    command, pid
        Command and process that run it.
    done, total : int
        Numbers of poses.
    left_s : float or None
        None if it is not known.
    what : str
        The present step, in words.
    simulated : bool
        Whether no real arm moves.
    """

    state: str
    command: str = ""
    pid: int = 0
    stoppable: bool = False
    done: int = 0
    total: int = 0
    left_s: float | None = None
    what: str = ""
    reason: str = ""
    simulated: bool = False


def progress_of(folder: Path) -> LiveProgress:
    """How far the run of a folder is."""
    entries = read_last_lines(folder / layout.JOURNAL_FILE, JOURNAL_BYTES)
    starts = [k for k, entry in enumerate(entries) if entry.get("event") == "run_started"]
    measured = {entry.get("pose") for entry in entries if entry.get("event") == "pose_done"}
    call = entries[starts[-1] :] if starts else []
    planned = call[0].get("n_poses") if call else None
    total = planned if isinstance(planned, int) else 0
    ends = [entry for entry in call if entry.get("event") == "run_stopped"]
    counted = {"done": len(measured), "total": max(total, len(measured)), "simulated": bool(call and call[0].get("simulated"))}
    owner = lock_owner(folder)
    held = owner is not None and holds_lock(owner.pid, folder)
    if owner is not None and held is not False:
        state = "uncertain" if held is None else "running"
        at = {"left_s": None if ends else _left_s(call, total - len(measured)), "what": _what(owner.command, call, bool(ends))}
        return LiveProgress(state, owner.command, owner.pid, bool(held), **counted, **at)
    if not ends:
        return LiveProgress("broken off" if call else "none", **counted)
    status, reason = str(ends[-1].get("exit_status", "")), str(ends[-1].get("reason", ""))
    return LiveProgress("ended" if status == "success" else "stopped", **counted, reason=reason)


def log_of(folder: Path) -> list[tuple[str, str, str]]:
    """(time of day UTC, level, source: text) of the last lines of a run's log."""
    lines = read_last_lines(folder / layout.LOG_FILE, LOG_BYTES)[-LOG_LINES:]
    return [(str(e.get("time", ""))[11:19], str(e.get("level", "")), f"{e.get('source', '')}: {e.get('text', '')}") for e in lines]


def _left_s(call: list[dict[str, Any]], poses: int) -> float | None:
    """The time left, from the poses between the first one of this call and the last; nothing is known of it before the second."""
    times = [entry.get("time_s") for entry in call if entry.get("event") == "pose_done"]
    known = [float(t) for t in times if isinstance(t, int | float)]
    return (known[-1] - known[0]) / (len(known) - 1) * poses if len(known) > 1 and poses > 0 else None


def _what(command: str, call: list[dict[str, Any]], measured: bool) -> str:
    done = [entry for entry in call if entry.get("event") == "pose_done"]
    if not call or not command.startswith(("run", "investigate", "extend", "check")):
        return f"mbcacq {command}"
    if measured:
        return "measured; calibrating and writing the report"
    if not done:
        return "connecting, or on the way to the first pose"
    return f"step {done[-1].get('step', '')}, station {done[-1].get('station', '')}, {done[-1].get('balls', 0)} balls at the last pose"
