"""Joint targets in the files of others: E6AXIS points of KRL programs (.src, .dat), CSV of joints or of poses; read, and written corrected.

Everything of a file but the corrected angles stays as it was, byte for byte.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3

MAX_BYTES = 64 << 20
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_GROUP = re.compile(r"\{[^{}]*\}")
POSE = ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")


@dataclass(frozen=True)
class ProgrammedPoints:
    """The points of a file. q: (P, n) rad as programmed, NaN where a file gives a pose alone; goals: (P, 4, 4) mm of the flange in the
    base, or None where the joints say it; names: (P,) for reports; lines: (P,) number in the file. left_alone: name, line and reason of
    each point of a program that does not say all joints.
    """

    q: np.ndarray
    goals: np.ndarray | None
    names: tuple[str, ...]
    lines: tuple[int, ...]
    left_alone: tuple[tuple[str, int, str], ...] = ()


def read_targets(path: Path, n: int) -> ProgrammedPoints:
    """The points of a .src, .dat or .csv file for an arm of n axes. Raises ConfigError naming file and line."""
    suffix = path.suffix.lower()
    if suffix in (".src", ".dat"):
        return _read_krl(path, _text(path), n)
    if suffix == ".csv":
        return _read_csv(path, _text(path), n)
    raise ConfigError(
        f"{path}: give a KRL program (.src, .dat) or a .csv of joints (q1_deg..) or of poses (x_mm, y_mm, z_mm, a_deg, b_deg, c_deg)"
    )


def written(
    path: Path, targets: ProgrammedPoints, q: np.ndarray, errors_mm: np.ndarray, reached: np.ndarray, reasons: Sequence[str]
) -> str:
    """The text of the file with corrected angles q (P, n) rad; of a point that cannot be reached the programmed ones stay."""
    text = _text(path)
    if path.suffix.lower() == ".csv":
        return _write_csv(text, q, errors_mm, reached, reasons)
    number = -1

    def corrected(match: re.Match[str]) -> str:
        nonlocal number
        if _angles(match.group(), q.shape[1]) is None:
            return match.group()
        number += 1
        return _with_angles(match.group(), np.degrees(q[number])) if reached[number] else match.group()

    return _outside_comments(text, corrected)


def _read_krl(path: Path, text: str, n: int) -> ProgrammedPoints:
    found: list[np.ndarray] = []
    lines: list[int] = []
    names: list[str] = []
    left: list[tuple[str, int, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        code = line.split(";", 1)[0]
        for match in _GROUP.finditer(code):
            named = re.search(r"(\w+)\s*=\s*$", code[: match.start()])
            name = named.group(1) if named else f"line {number}"
            angles = _angles(match.group(), n)
            if angles is None:
                reason = _no_joint_point(match.group())
                left += [(name, number, reason)] if reason else []
                continue
            found.append(angles)
            lines.append(number)
            names.append(name)
    if not found:
        raise ConfigError(
            f"{path}: has no E6AXIS point with {', '.join(f'A{i + 1}' for i in range(n))}; poses (E6POS) have no joint angles"
        )
    return ProgrammedPoints(np.radians(np.array(found)), None, tuple(names), tuple(lines), tuple(left))


def _no_joint_point(group: str) -> str:
    """Why an aggregate without all joint angles is a point nevertheless; empty for tool data, frames and the like."""
    if re.search(rf"\bA[1-9]\s+{_NUMBER}", group, re.IGNORECASE):
        return "has not the angles of all axes"
    if all(re.search(rf"\b{word}\s+[-+'\w.]", group, re.IGNORECASE) for word in ("X", "Y", "Z", "S", "T")):
        return "is a pose, whose joints are the controller's choice"
    return ""


def _angles(group: str, n: int) -> np.ndarray | None:
    """(n,) deg of an aggregate such as {A1 0,A2 -90,...}; None for another one."""
    out = []
    for i in range(1, n + 1):
        match = re.search(rf"\bA{i}\s+({_NUMBER})", group, re.IGNORECASE)
        if match is None:
            return None
        out.append(float(match.group(1)))
    return np.array(out)


def _with_angles(group: str, degrees: np.ndarray) -> str:
    for i, value in enumerate(degrees, 1):
        group = re.sub(rf"(\bA{i}\s+){_NUMBER}", lambda m, v=value: f"{m.group(1)}{v + 0.0:.6f}", group, count=1, flags=re.IGNORECASE)
    return group


def _outside_comments(text: str, replace) -> str:
    """The text with every aggregate outside of a comment replaced."""
    out = []
    for line in text.splitlines(keepends=True):
        code, mark, comment = line.partition(";")
        out.append(_GROUP.sub(replace, code) + mark + comment)
    return "".join(out)


def _read_csv(path: Path, text: str, n: int) -> ProgrammedPoints:
    rows = list(csv.reader(io.StringIO(text)))
    if len(rows) < 2:
        raise ConfigError(f"{path}: has no points; give a header and one line a point")
    header = [h.strip().lower() for h in rows[0]]
    joints = _columns(header, [[f"q{i}_deg", f"a{i}", f"q{i}"] for i in range(1, n + 1)])
    pose = _columns(header, [[name] for name in POSE])
    if joints is None and pose is None:
        raise ConfigError(f"{path}:1: has neither q1_deg..q{n}_deg nor {', '.join(POSE)}; name the columns so")
    q, goals, lines = [], [], []
    for number, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            raise ConfigError(f"{path}:{number}: is empty; remove the line")
        q.append(np.radians(_values(path, number, row, joints)) if joints is not None else np.full(n, np.nan))
        lines.append(number)
        if pose is not None:
            v = _values(path, number, row, pose)
            goals.append(se3.from_abc(v[:3], np.radians(v[3:])))
    names = tuple(f"line {number}" for number in lines)
    return ProgrammedPoints(np.array(q), np.array(goals) if goals else None, names, tuple(lines))


def _columns(header: list[str], wanted: list[list[str]]) -> list[int] | None:
    found = [next((header.index(name) for name in names if name in header), None) for names in wanted]
    return None if any(f is None for f in found) else [f for f in found if f is not None]


def _values(path: Path, number: int, row: list[str], columns: list[int]) -> np.ndarray:
    try:
        values = np.array([float(row[c]) for c in columns])
    except (ValueError, IndexError):
        raise ConfigError(f"{path}:{number}: a value is missing or no number; correct the line") from None
    if not np.all(np.isfinite(values)):
        raise ConfigError(f"{path}:{number}: a value is not finite; correct the line")
    return values


def _write_csv(text: str, q: np.ndarray, errors_mm: np.ndarray, reached: np.ndarray, reasons: Sequence[str]) -> str:
    rows = list(csv.reader(io.StringIO(text)))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\r\n" if "\r\n" in text else "\n")
    more = [f"corrected_q{i + 1}_deg" for i in range(q.shape[1])]
    writer.writerow([*rows[0], *more, "residual_mm", "reached", "reason"])
    for row, angles, error, ok, reason in zip(rows[1:], np.degrees(q), errors_mm, reached, reasons, strict=True):
        values = [f"{v + 0.0:.6f}" for v in angles] if ok else [""] * len(angles)
        writer.writerow([*row, *values, f"{error:.6f}", str(bool(ok)).lower(), reason])
    return out.getvalue()


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes()[: MAX_BYTES + 1]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give a KRL program or a CSV file") from error
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; split it")
    return raw.decode("latin-1")
