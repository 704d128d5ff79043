"""The history of an arm's checks: one file, written whole after each of them, from which everything that is said follows anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat

from mbcacq.errors import RecordingError
from mbcacq.files.atomic_write import write_file
from mbcacq.interim_check.options import UsualChanges
from mbcacq.model.json_text import InJson, Matrix, Transform, damaged, fields_as_json, from_document, read_json, sealed_text, unsealed

FORMAT = "mbcacq-check/1"
MICROMETRE = 5  # decimals of a residual in mm


CentreRow = tuple[int, int, FiniteFloat, FiniteFloat, FiniteFloat]  # pose, ball, x, y, z


def _as_rows(residual: Mapping[tuple[int, int], np.ndarray]) -> list[list[float]]:
    return [[pose, ball, *(round(float(v), MICROMETRE) for v in xyz)] for (pose, ball), xyz in residual.items()]


Residuals = Annotated[
    Mapping[tuple[int, int], np.ndarray],
    InJson(list[CentreRow], lambda rows: {(pose, ball): np.array(xyz) for pose, ball, *xyz in rows}, _as_rows),
]


@dataclass(frozen=True, kw_only=True)
class CheckedDay:
    """One check.

    Attributes
    ----------
    time : str
        ISO 8601, UTC.
    run : str
        Its folder.
    residual : Residuals
        (pose number, ball id) -> (3,) mm in the scanner frame, measured minus predicted by the calibrated cell with the stations of the
        history.
    log_e, log_e_calibration : float or None
        Evidence as judged on that day; None before.
    """

    time: str
    run: str
    log_e: float | None = None
    log_e_calibration: float | None = None
    residual: Residuals = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class CheckHistory:
    """All checks of one calibration.

    Attributes
    ----------
    result : str
        SHA-256 of the calibration that is checked.
    plan : str
        Name of the plan.
    poses : tuple[int, ...]
        Numbers of those that a check repeats, with the joint angles q (P, n) rad they had.
    standing : bool
        Artefacts stay between checks.
    stations : Mapping[str, Transform]
        T_base_station (4, 4) by id, as the first check found them.
    noise : ndarray or None
        (R, R) mm^2 of the points of a part, as the first check found it; None of balls, whose noise is that of the calibration.
    days : tuple[CheckedDay, ...]
        All checks, in order.
    usual_days : UsualChanges
        Changes from day to day without a cause.
    """

    result: str
    plan: str
    poses: tuple[int, ...]
    q: Annotated[Matrix, Field(alias="q_rad")]
    standing: bool
    usual_days: UsualChanges
    stations: Mapping[str, Transform] = field(default_factory=dict)
    noise: Annotated[Matrix | None, Field(alias="noise_mm2")] = None
    days: tuple[CheckedDay, ...] = ()

    def judged(self, log_e: float, log_e_calibration: float) -> CheckHistory:
        """The history with the evidence of the last day."""
        return replace(self, days=(*self.days[:-1], replace(self.days[-1], log_e=log_e, log_e_calibration=log_e_calibration)))

    def write(self, path: Path) -> None:
        """Write the file, whole and with its checksum; it replaces an earlier one once it is on the disk. Raises RecordingError."""
        write_file(path, sealed_text({"format": FORMAT} | fields_as_json(self)))


def read_history(path: Path) -> CheckHistory | None:
    """The history in a file; None if there is none. Raises ConfigError if it is damaged or none of ours, RecordingError if it
    cannot be read."""
    try:
        text = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}; make it readable, or give another --history") from error
    advice = "give another --history, or move this file away to begin anew"
    content = unsealed(read_json(text, str(path), advice), path, "take its copy from a backup, move it away to begin anew")
    history = from_document(CheckHistory, content, FORMAT, str(path), "history of checks", advice)
    if len(history.q) != len(history.poses):
        raise damaged(str(path), f"{len(history.q)} rows of joint angles for {len(history.poses)} poses", advice)
    return history
