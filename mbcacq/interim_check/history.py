"""The history of an arm's checks: one file, written whole after each of them, from which everything that is said follows anew."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration.sealed_json import sealed_text, unsealed
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.files.atomic_write import write_file
from mbcacq.interim_check.options import UsualChanges
from mbcacq.model.json_text import damage, read_json

FORMAT = "mbcacq-check/1"
MICROMETRE = 5  # decimals of a residual in mm


@dataclass(frozen=True)
class CheckedDay:
    """One check. time: ISO 8601, UTC; run: its folder; residual: (pose number, ball id) -> (3,) mm in the scanner frame, measured minus
    predicted by the calibrated cell with the stations of the history. log_e, log_e_calibration: as judged on that day, None before."""

    time: str
    run: str
    residual: Mapping[tuple[int, int], np.ndarray]
    log_e: float | None = None
    log_e_calibration: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON content."""
        rows = [[p, b, *(round(float(v), MICROMETRE) for v in xyz)] for (p, b), xyz in self.residual.items()]
        said = {"log_e": self.log_e, "log_e_calibration": self.log_e_calibration}
        return {"time": self.time, "run": self.run, **said, "residual": rows}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> CheckedDay:
        """The day that ``to_dict`` wrote. Raises KeyError, TypeError or ValueError where it is damaged."""
        rows = {(int(p), int(b)): np.array([x, y, z], dtype=float) for p, b, x, y, z in content["residual"]}
        if not all(np.isfinite(v).all() for v in rows.values()):
            raise ValueError("a residual is no number")
        log_e, since = (None if content[key] is None else float(content[key]) for key in ("log_e", "log_e_calibration"))
        return cls(str(content["time"]), str(content["run"]), rows, log_e, since)


@dataclass(frozen=True, kw_only=True)
class CheckHistory:
    """result: SHA-256 of the calibration that is checked; plan: name of the plan; poses: numbers of those that a check
    repeats, with the joint angles q (P, n) rad they had; standing: artefacts stay between checks; stations: T_base_station (4, 4) by id, as
    the first check found them; days: all checks, in order; usual_days: what changes from day to day without a cause."""

    result: str
    plan: str
    poses: tuple[int, ...]
    q: np.ndarray
    standing: bool
    usual_days: UsualChanges
    stations: Mapping[str, np.ndarray] = field(default_factory=dict)
    days: tuple[CheckedDay, ...] = ()

    def with_day(self, day: CheckedDay) -> CheckHistory:
        """With one more check."""
        return replace(self, days=(*self.days, day))

    def judged(self, log_e: float, log_e_calibration: float) -> CheckHistory:
        """With what was judged on the last day."""
        return replace(self, days=(*self.days[:-1], replace(self.days[-1], log_e=log_e, log_e_calibration=log_e_calibration)))

    def to_dict(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "format": FORMAT,
            "result": self.result,
            "plan": self.plan,
            "poses": list(self.poses),
            "q_rad": self.q.tolist(),
            "standing": self.standing,
            "usual_days": asdict(self.usual_days),
            "stations": {name: T.tolist() for name, T in self.stations.items()},
            "days": [day.to_dict() for day in self.days],
        }

    def write(self, path: Path) -> None:
        """Write the file, whole and with its checksum; it replaces an earlier one once it is on the disk. Raises RecordingError."""
        write_file(path, sealed_text(self.to_dict()))


def read_history(path: Path) -> CheckHistory | None:
    """The history in a file; None where there is none. Raises ConfigError where it is damaged or none of ours, RecordingError where it
    cannot be read."""
    try:
        text = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}; make it readable, or give another --history") from error
    advice = "give another --history, or move this file away to begin anew"
    content = read_json(text, str(path), advice)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigError(f"{path} is no history of checks of format '{FORMAT}'; {advice}")
    content = unsealed(content, path)
    try:
        history = _history(content)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path} is damaged ({damage(error)}); {advice}") from error
    return history


def _history(content: Mapping[str, Any]) -> CheckHistory:
    stations = {str(name): np.array(T, dtype=float).reshape(4, 4) for name, T in content["stations"].items()}
    poses = tuple(int(p) for p in content["poses"])
    q = np.array(content["q_rad"], dtype=float).reshape(len(poses), -1)
    usual = UsualChanges(**content["usual_days"])
    figures = [v for v in asdict(usual).values() if not isinstance(v, str)]
    if not (np.isfinite(q).all() and all(math.isfinite(float(v)) and v >= 0 for v in figures)):
        raise ValueError("a figure is no number")
    days = tuple(CheckedDay.from_dict(day) for day in content["days"])
    return CheckHistory(
        result=str(content["result"]),
        plan=str(content["plan"]),
        poses=poses,
        q=q,
        standing=bool(content["standing"]),
        usual_days=usual,
        stations=stations,
        days=days,
    )
