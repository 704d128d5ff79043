"""Hand-eye data as other programs keep them: samples of MoveIt and easy_handeye2, pairs of pose files, folders of 4 x 4 matrices.

Each becomes a table of two poses a row, the flange's and the target's, and is then understood as any table is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.files.table import Table
from mbcacq.geometry import se3
from mbcacq.model import yaml12
from mbcacq.recording.datasets import quaternions
from mbcacq.recording.datasets.columns import groups
from mbcacq.recording.datasets.csv_columns import numbers
from mbcacq.recording.datasets.length_table import read_lengths
from mbcacq.recording.datasets.line_profiles import read_profiles
from mbcacq.recording.datasets.loose_table import SUFFIXES, TableOptions, UnderstoodTable, read_loose_table, table_of, understood
from mbcacq.recording.datasets.pose_columns import PoseHeadings
from mbcacq.recording.datasets.profiles_in_motion import read_profiles_in_motion

MAX_BYTES = 1 << 26
SAMPLES = (".yaml", ".yml", ".samples")  # of MoveIt; easy_handeye2 calls its files NAME.samples
MATRIX_NAMES = tuple(f"r{i}{j}" for i in range(4) for j in range(4))
ROBOT_FILE = re.compile(r"(rob|pos(e)?[_-]?\d|flange|tcp|gripper|hand|base)", re.IGNORECASE)
TARGET_FILE = re.compile(r"(target|board|marker|object|cam|eye|pattern|calib|detection)", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_FILE_NUMBER = re.compile(r"(\d+)")
LONGEST_GAP_S = 0.02  # between the times of two poses that are taken as one, without interpolation


def read_hand_eye_files(files: Sequence[Path], options: TableOptions) -> UnderstoodTable:
    """What one or two files, or a folder, say. Raises ConfigError where they are of no form that is known."""
    first = files[0]
    for file in files:
        if not file.exists():
            raise ConfigError(f"{file} does not exist; give a table of poses, a file of samples, or a folder of matrices")
    if len(files) == 2 and all(f.suffix.lower() in SUFFIXES for f in files):
        poses, points = (table_of(f, options) for f in files)
        if (in_motion := read_profiles_in_motion(poses, points, options)) is not None:
            return in_motion
        if (profiles := read_profiles(points, options, poses)) is not None:
            return profiles
        return understood(_paired(first, files[1], options), replace(options, columns={}))
    if len(files) > 1:
        raise ConfigError("give one table, one file of samples, one folder, or two tables of poses (the flange's, then the target's)")
    if first.is_dir():
        return understood(_of_folder(first), options)
    if first.suffix.lower() in SAMPLES:
        return _of_samples(first, options)
    table = table_of(first, options)
    return read_profiles(table, options) or read_lengths(table, options) or read_loose_table(first, options)


def _of_samples(path: Path, options: TableOptions) -> UnderstoodTable:
    """MoveIt: a list of effector_wrt_world and object_wrt_sensor, 16 numbers each. easy_handeye2: samples of robot and tracking
    transforms."""
    content = _yaml(path)
    samples = content.get("samples") if isinstance(content, dict) else content
    if not isinstance(samples, list) or not samples or not all(isinstance(s, dict) for s in samples):
        raise ConfigError(f"{path}: no list of samples; give what MoveIt or easy_handeye2 saved, or a table of poses")
    try:
        if "effector_wrt_world" in samples[0]:
            hand, eye = (np.array([_matrix(s[key]) for s in samples]) for key in ("effector_wrt_world", "object_wrt_sensor"))
        elif "robot" in samples[0]:
            hand, eye = (np.array([_ros_transform(s[key]) for s in samples]) for key in ("robot", "tracking"))
            if options.measurement is None:
                raise ConfigError(
                    f"{path}: easy_handeye2 keeps the robot's transform inverted where the camera is fixed, which the data cannot show; "
                    "say "
                    "--eye-in-hand or --eye-to-hand"
                )
            hand = se3.inverse(hand) if options.measurement == "target_in_base" else hand
        else:
            raise ConfigError(f"{path}: samples hold {', '.join(map(str, samples[0]))}; effector_wrt_world or robot is expected")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: a sample is damaged ({error!r}); save the samples anew") from None
    return understood(_table(path, hand, eye), replace(options, length="m"))


def _yaml(path: Path) -> Any:
    if path.stat().st_size > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; split it")
    try:
        return yaml12.load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not a YAML file ({str(error).splitlines()[0]})") from None


def _matrix(values: Any) -> np.ndarray:
    T = np.array(values, dtype=float).reshape(4, 4)
    if not np.allclose(T[3], [0, 0, 0, 1], atol=1e-3):
        T = T.T  # column by column, as some write it
    if not np.allclose(T[3], [0, 0, 0, 1], atol=1e-3):
        raise ValueError("the last row of a matrix is not 0 0 0 1, nor its last column")
    return T


def _ros_transform(content: dict[str, Any]) -> np.ndarray:

    content = content.get("transform", content)
    t, r = content["translation"], content["rotation"]
    turn = np.array([r[c] for c in "wxyz"], float)
    if not (np.abs(turn) < 2).all() or abs(np.linalg.norm(turn) - 1) > quaternions.UNIT:
        raise ValueError(f"the quaternion {r} has a length that is not 1")
    return se3.transform(quaternions.to_matrix(turn), np.array([t[c] for c in "xyz"], float))


def _table(path: Path, hand: np.ndarray, eye: np.ndarray) -> Table:
    """A table of two matrices a row, in the units of their file."""
    columns = {}
    for thing, T in (("flange", hand), ("target", eye)):
        columns |= {f"{thing}_{name}": tuple(numbers(T.reshape(len(T), 16)[:, k])) for k, name in enumerate(MATRIX_NAMES)}
    return Table(path, columns, list(range(1, len(hand) + 1)))


def _of_folder(folder: Path) -> Table:
    """A folder with one file of 16 numbers for each pose of the flange and one for each of the target, paired by the number in the name."""
    hand, eye = dict(_matrices(folder, ROBOT_FILE, TARGET_FILE)), dict(_matrices(folder, TARGET_FILE, None))
    both = sorted(set(hand) & set(eye))
    if not both:
        raise ConfigError(
            f"{folder}: no pairs of files with 4 x 4 matrices (found {len(hand)} of the robot, such as pos01.yaml, and {len(eye)} of "
            "the target, "
            "such as target01.txt); images and clouds must be turned into poses first, see 'Hand-eye with my camera' in the documentation"
        )
    return _table(folder, np.array([hand[k] for k in both]), np.array([eye[k] for k in both]))


def _matrices(folder: Path, names: re.Pattern, but_not: re.Pattern | None) -> Iterator[tuple[int, np.ndarray]]:
    for path in sorted(folder.iterdir()):
        number = _FILE_NUMBER.findall(path.stem)
        known = names.search(path.stem) and not (but_not and but_not.search(path.stem))
        if not (number and known and path.suffix.lower() in (".yaml", ".yml", ".txt", ".json", ".csv", ".dat")):
            continue
        found = [float(text) for text in _NUMBER.findall(_data_of(path.read_text(encoding="utf-8", errors="replace")))]
        if len(found) >= 16:
            try:
                yield int(number[-1]), _matrix(found[-16:])
            except ValueError as error:
                raise ConfigError(f"{path}: {error}; correct it") from None


def _data_of(text: str) -> str:
    """The numbers of an OpenCV file (data: [...]), all numbers of any other file."""
    found = re.search(r"data\s*\"?\s*:\s*\[(.*?)\]", text, re.DOTALL)
    return found[1] if found else text


def _paired(hand_file: Path, eye_file: Path, options: TableOptions) -> Table:
    """Two tables of poses, the flange's and the target's: by their times where both have them, else row by row."""
    hand, eye = (table_of(f, options) for f in (hand_file, eye_file))
    groups = [_whole_pose(t) for t in (hand, eye)]
    rows = _pairs_by_time(hand, eye)
    columns: dict[str, tuple[str, ...]] = {}
    for thing, table, group, at in (("flange", hand, groups[0], rows[0]), ("target", eye, groups[1], rows[1])):
        for name in group.names:
            columns[f"{thing} {name}"] = tuple(table.columns[name][i] for i in at)
    return Table(hand_file, columns, [hand.line[i] for i in rows[0]])


def _whole_pose(table: Table) -> PoseHeadings:
    found = [g for g in groups(table) if g.rotation]
    if not found:
        raise ConfigError(f"{table.path}:1: no pose in the columns {', '.join(table.columns)}; name them x, y, z, q_x, q_y, q_z, q_w")
    return found[0]


def _pairs_by_time(hand: Table, eye: Table) -> tuple[np.ndarray, np.ndarray]:
    """Rows of both tables that belong together."""
    names = [next((n for n in t.columns if n.strip().lower() in ("t", "time", "time_s", "timestamp", "t [s]")), None) for t in (hand, eye)]
    if names[0] is None or names[1] is None:
        if len(hand) != len(eye):
            raise ConfigError(f"{eye.path}: {len(eye)} rows, and {hand.path} has {len(hand)}; without times each row must have its partner")
        return np.arange(len(hand)), np.arange(len(eye))
    a, b = hand.number(names[0]), eye.number(names[1])
    nearest = np.abs(a[:, None] - b).argmin(axis=0) if len(a) * len(b) < MAX_BYTES else np.searchsorted(a, b).clip(0, len(a) - 1)
    close = np.abs(a[nearest] - b) < LONGEST_GAP_S
    if close.sum() < len(b) / 2:
        raise ConfigError(
            f"{eye.path}: only {int(close.sum())} of {len(b)} rows were measured within {LONGEST_GAP_S:g} s of a pose in {hand.path}; "
            "their clocks "
            "differ or the arm was moving: mbcacq data merge"
        )
    return nearest[close], np.flatnonzero(close)
