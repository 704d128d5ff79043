"""Timing and health of the devices, read from the recording of a run: late answers, periods, exposures, states, and what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import MbcacqError
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.reader import open_recordings
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.journal import read_log
from mbcacq.report.content import Devices

MAX_GAPS = 40
TIMING = ("time_s", "host_time_s", "delay")  # of a cycle


def devices_of(run: str | Path) -> Devices | None:
    """None where ``run`` is no folder with a recording, or the recording cannot be read: the report then does without."""
    run = Path(run)
    try:
        recordings = open_recordings(run) if run.is_dir() and layout.parts(run) else []
        if not recordings:
            return None
        cycles = [recording.cycles(TIMING).columns for recording in recordings]
        late, period, nominal = _cycles([c for c in cycles if len(c.get("time_s", ()))])
        exposures = np.concatenate([_exposures(recording.rows(layout.EXPOSURE)) for recording in recordings])
        states: dict[str, float] = {}
        for recording in recordings:
            for name, seconds in _states(recording.rows(layout.STATE)).items():
                states[name] = states.get(name, 0.0) + seconds
        health = _health(recordings)
    except MbcacqError:
        return None
    return Devices(
        late=late,
        period_ms=period,
        nominal_ms=nominal,
        exposure_s=exposures if len(exposures) else None,
        state_s=sorted(states.items(), key=lambda item: -item[1]),
        gaps=gaps_and_warnings(run),
        health=health,
    )


def _cycles(columns: Sequence[Mapping[str, np.ndarray]]) -> tuple[np.ndarray | None, np.ndarray | None, float | None]:
    if not columns:
        return None, None, None
    late = np.concatenate([c["delay"] for c in columns]) if all("delay" in c for c in columns) else None
    period = np.concatenate([1e3 * np.diff(c["host_time_s"]) for c in columns])
    nominal = 1e3 * float(np.median(np.concatenate([np.diff(c["time_s"]) for c in columns])))
    return late, period if len(period) else None, nominal if np.isfinite(nominal) else None


def _exposures(rows: Any) -> np.ndarray:
    """(e,) s between successive exposures of one pose, finding the balls included."""
    exposures = [(int(row["pose"][0]), int(row["exposure"][0]), _seconds(row[layout.TIME])) for row in rows if "exposure" in row]
    return np.array([t - s for (p, i, s), (q, j, t) in pairwise(exposures) if p == q and j == i + 1])


def _states(rows: Any) -> dict[str, float]:
    changes = [(row["state"][0], _seconds(row[layout.TIME])) for row in rows if "state" in row]
    out: dict[str, float] = {}
    for (state, start), (_, end) in pairwise(changes):
        out[state] = out.get(state, 0.0) + end - start
    return out


def _health(recordings: list) -> list[tuple[str, str, str, str]]:
    """Lowest, highest and last value of every quantity that varied or is a temperature."""
    found: dict[str, list[float]] = {}
    for recording in recordings:
        for entity, values in recording.scalars(f"{layout.HEALTH}/**").items():
            found.setdefault(entity.removeprefix(f"/{layout.HEALTH}/").replace("/", ": ").replace("\\", ""), []).extend(values)
    return [
        (name, f"{min(values):.6g}", f"{max(values):.6g}", f"{values[-1]:.6g}")
        for name, values in sorted(found.items())
        if values and (min(values) != max(values) or name.endswith("_C"))
    ]


def gaps_and_warnings(run: Path) -> list[str]:
    """What the recording lacks, and the warnings and errors of the log."""
    out = [*find_gaps(run), *(str(e["text"]) for e in read_log(run) if e.get("level") in ("warning", "error") and e.get("text"))]
    out = list(dict.fromkeys(out))
    return out if len(out) <= MAX_GAPS else [*out[:MAX_GAPS], f"and {len(out) - MAX_GAPS} more: see {layout.LOG_FILE}"]


def _seconds(value: Any) -> float:
    """A duration of the recording (ns) in s."""
    return float(value) * 1e-9
