"""Programs and lists of points corrected by a calibrated arm with its effects."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.joint_targets import JointTargets, joint_targets
from mbcacq.errors import ConfigError
from mbcacq.exports.programs import LANGUAGES, read_program
from mbcacq.exports.programs.points_csv import read_points
from mbcacq.files.atomic_write import write_file
from mbcacq.model.json_text import AsJson, FilePath, keyed
from mbcacq.quantities import in_degrees
from mbcacq.workflow.corrected_targets import refuse_uncalibrated
from mbcacq.workflow.load import as_cell, refuse_existing

TRIES = 24  # starts for a pose without joint angles
MAKES = {
    "KUKA": r"kuka|agilus|quantec|fortec|iiwa|\bkr ?\d",
    "Universal Robots": r"universal.?robot|\bur ?\d",
    "ABB": r"\babb\b|\birb|gofa|yumi",
    "FANUC": r"fanuc|lr.?mate|\bcrx|\bm-?\d+i[a-d]",
    "other": r"yaskawa|motoman|st[aä]ubli|franka|panda|doosan|kawasaki|denso|mitsubishi|epson|comau|nachi|techman|xarm|kinova",
}
LANGUAGE_MAKES = {
    "KUKA": ((".src", ".dat"), "KRL"),
    "Universal Robots": ((".script", ".urscript"), "URScript"),
    "ABB": ((".mod", ".modx", ".prg", ".sys"), "RAPID"),
    "FANUC": ((".ls",), "LS"),
}
LARGE_CHANGE_DEG = 2.0  # of a joint: more than any calibration of an arm in good order asks for


@dataclass(frozen=True, kw_only=True)
class CorrectedPoint:
    """One point of a file.

    Attributes
    ----------
    line : int
        Where it stands.
    q_deg : tuple[float, ...]
        The corrected angles.
    before_mm : float or None
        Distance by which the arm misses its nominal place with the programmed angles; None if none are programmed.
    residual_mm, residual_deg : float
        Distance and angle by which it misses with the corrected ones, by the model.
    largest_change_deg : float or None
        Largest change of a joint, None if none are programmed.
    reached : bool
        Whether the point is corrected.
    reason : str
        Why the point is not corrected.
    """

    name: str
    line: int
    q_deg: tuple[float, ...]
    before_mm: float | None
    residual_mm: float
    residual_deg: float
    largest_change_deg: float | None
    reached: bool
    reason: str


LeftAlone = Annotated[tuple[str, int, str], keyed("name", "line", "reason")]


@dataclass(frozen=True, kw_only=True)
class _Remarks:
    """What is said of a file. left_alone: name, line and reason of each point of a program that stays as it is, since it is no absolute
    target or does not say all joints. notes: what was assumed.
    """

    left_alone: tuple[LeftAlone, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Correction(_Remarks, AsJson):
    """One file."""

    format: Literal["mbcacq-correction/1"] = "mbcacq-correction/1"
    file: FilePath
    points: tuple[CorrectedPoint, ...]


@dataclass(frozen=True, kw_only=True)
class _Points(_Remarks):
    """The points of a file, q (P, n) rad as programmed and goals (P, 4, 4) mm, or None if the joints say it; written: the file with
    what was found."""

    q: np.ndarray
    goals: np.ndarray | None = None
    names: tuple[str, ...]
    lines: tuple[int, ...]
    written: Callable[[JointTargets], bytes]


def correct(
    program: Path | str,
    cell: CalibratedCell | dict[str, Any] | Path | str,
    out: Path | str | None = None,
    *,
    force: bool = False,
    simulated_anyway: bool = False,
) -> Correction:
    """Write a copy of a robot program whose joint angles bring the calibrated arm, with its effects, to the nominal places.

    A nominal place is where the programmed angles bring the nominal arm, or what a CSV file gives as a pose of the flange.

    Parameters
    ----------
    program
        A program in KRL, URScript, RAPID or FANUC LS, or a CSV file.
    cell
        A calibrated cell, its content as a dictionary, a result.json, or a run folder that holds one.
    out
        The file to write (default: the name with '_corrected').
    force
        Replace a file that exists.
    simulated_anyway
        Use a simulated calibration too.

    Returns
    -------
    Correction
        The points of the file, corrected or with the reason why not, and what was left alone.

    Raises
    ------
    ConfigError
        The file has no absolute joint targets, the arm was not calibrated, the output exists, or a point outside the limits is programmed.
    RecordingError
        The copy cannot be written.
    """
    program = Path(program)
    output = Path(out) if out is not None else program.with_name(f"{program.stem}_corrected{program.suffix}")
    if output.resolve() == program.resolve():
        raise ConfigError(f"{output} is the program itself; give another --out")
    refuse_existing(output, force, f"{output} exists; give another --out, or --force to replace it")
    arm = as_cell(cell)
    nominal = arm.nominal
    refuse_uncalibrated(arm, simulated_anyway)
    refuse_other_make(program, arm.robot)
    points = _points(program, nominal.n)
    programmed = np.all(np.isfinite(points.q), axis=1)
    goals = points.goals if points.goals is not None else nominal.flange(points.q)
    start = np.where(programmed[:, None], points.q, np.zeros(nominal.n))
    found = joint_targets(arm, goals, start, arm.limits) if programmed.all() else _from_anywhere(arm, goals)
    missed_mm = np.linalg.norm(arm.frames(start)[:, -1, :3, 3] - goals[:, :3, 3], axis=1)
    change_deg = in_degrees(np.abs(found.q - start).max(axis=1))
    write_file(output, points.written(found))
    corrected = tuple(
        CorrectedPoint(
            name=name,
            line=line,
            q_deg=tuple(in_degrees(found.q[p]).tolist()),
            before_mm=float(missed_mm[p]) if programmed[p] else None,
            residual_mm=float(found.error_mm[p]),
            residual_deg=float(in_degrees(found.error_rad[p])),
            largest_change_deg=float(change_deg[p]) if programmed[p] else None,
            reached=bool(found.reached[p]),
            reason=found.reasons[p],
        )
        for p, (name, line) in enumerate(zip(points.names, points.lines, strict=True))
    )
    notes = points.notes
    if output.suffix.lower() in LANGUAGE_MAKES["KUKA"][0] and output.stem.lower() != program.stem.lower():
        notes += (f"a KUKA controller knows a program by its file: copy .src and .dat back together, both as {program.stem}",)
    return Correction(file=output, points=corrected, left_alone=points.left_alone, notes=notes)


def refuse_other_make(program: Path, robot: str) -> None:
    """Raises ConfigError if the language of a program is one make's, and the arm's name says another."""
    makes = {make for make, word in MAKES.items() if re.search(word, robot, re.IGNORECASE)}
    of_program = next((make for make, (suffixes, _) in LANGUAGE_MAKES.items() if program.suffix.lower() in suffixes), None)
    if of_program and makes and of_program not in makes:
        raise ConfigError(
            f"{program}: {LANGUAGE_MAKES[of_program][1]} is the language of {of_program} arms, and this result is of '{robot}'; give the "
            "result of the arm that runs the program"
        )


def _points(path: Path, n: int) -> _Points:
    """The points of a file. Raises ConfigError naming file and line."""
    suffix = path.suffix.lower()
    if suffix in LANGUAGES:
        program, encode = read_program(path, n)
        names, lines = tuple(point.name for point in program.points), tuple(point.line for point in program.points)

        def text(found: JointTargets) -> bytes:
            return encode(program.written(found.q, found.reached.tolist()))

        return _Points(q=program.q, names=names, lines=lines, left_alone=program.left_alone, notes=program.notes, written=text)
    if suffix != ".csv":
        raise ConfigError(
            f"{path}: give a robot program ({', '.join(LANGUAGES)}), or a .csv of joints (q1_deg..) or of poses "
            "(x_mm, y_mm, z_mm, a_deg, b_deg, c_deg)"
        )
    table = read_points(path, n)

    def rows(found: JointTargets) -> bytes:
        return table.written(found.q, found.error_mm, found.reached, found.reasons)

    names = tuple(f"line {line}" for line in table.lines)
    return _Points(q=table.q, goals=table.goals, names=names, lines=table.lines, written=rows)


def _from_anywhere(arm: CalibratedCell, goals: np.ndarray) -> JointTargets:
    """Poses without joint angles: from several starts, the solution with the smallest angles."""
    n = arm.nominal.n
    low, high = (np.full(n, -np.pi), np.full(n, np.pi)) if arm.limits is None else np.clip(arm.limits, -np.pi, np.pi).T
    rng = np.random.default_rng(0)
    best: JointTargets | None = None
    for number in range(TRIES):
        start = np.tile((low + high) / 2 if number == 0 else rng.uniform(low, high), (len(goals), 1))
        new = joint_targets(arm, goals, start, arm.limits)
        best = new if best is None else _nearer(best, new)
    assert best is not None, "there is at least one start"
    return best


def _nearer(a: JointTargets, b: JointTargets) -> JointTargets:
    size = [np.abs(t.q).max(axis=1) + np.where(t.reached, 0.0, 1e3 + t.error_mm) for t in (a, b)]
    use = size[1] < size[0]
    q, error_mm, error_rad, reached = (
        np.where(use.reshape(-1, *[1] * (x.ndim - 1)), y, x) for x, y in zip(_arrays(a), _arrays(b), strict=True)
    )
    reasons = tuple(y if u else x for u, x, y in zip(use, a.reasons, b.reasons, strict=True))
    return JointTargets(q, error_mm, error_rad, reached, reasons)


def _arrays(t: JointTargets) -> tuple[np.ndarray, ...]:
    return t.q, t.error_mm, t.error_rad, t.reached
