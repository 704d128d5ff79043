"""The observation set, a folder of ``cell.yaml``, ``poses.csv`` and ``centres.csv``, as ``Observations``.

Numbers come back bit for bit. Columns this program does not know are kept in ``Observations.extra`` and written back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import read_bounded
from mbcacq.files.table import Table, read_table
from mbcacq.model.board_images import FORMAT as IMAGES_FORMAT
from mbcacq.model.board_images import BoardImages
from mbcacq.model.cell import Cell, RobotModel, arm_of_flange_poses
from mbcacq.model.json_text import from_document, read_json
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets import covariances
from mbcacq.recording.datasets.bag import bag_of, observation_columns
from mbcacq.recording.datasets.cell_yaml import read_cell
from mbcacq.recording.datasets.columns import columns_of, flange_columns, flange_group, target_columns
from mbcacq.recording.datasets.columns_of_joints import headings, read_joints
from mbcacq.recording.datasets.csv_columns import CENTRES, FLANGE_VELOCITY, QUATERNION, XYZ, poses_schema, refuse_radians, rotations
from mbcacq.recording.datasets.observation_writer import IMAGES
from mbcacq.recording.datasets.observation_writer import write_observation_set as write_observation_set
from mbcacq.recording.datasets.scan_folder import centres_from_scans
from mbcacq.recording.datasets.uncertified import with_estimated_centres
from mbcacq.recording.datasets.wide_table import complete, wide_centres

MAX_IMAGES = 1 << 26  # bytes
ANEW = "make the set anew with mbcacq data new"


def read_observation_set(folder: Path | str) -> Observations:
    """Read a folder. Raises ConfigError naming file, line and column of the first fault."""
    folder = Path(folder)
    cell, text = read_cell(folder / "cell.yaml")
    return read_observations(folder, cell, text)


def read_observations(folder: Path, cell: Cell, text: str) -> Observations:
    """What a folder holds beside its cell.yaml: ``cell``, of this text. Raises ConfigError as ``read_observation_set``."""
    bag = None if (folder / "poses.csv").exists() else bag_of(text, folder)
    if bag is not None:
        return Observations(cell=cell, **observation_columns(folder, bag, cell), cell_yaml=text)
    names = columns_of(text)
    table = read_table(folder / "poses.csv", poses_schema(cell.robot, cell.ball_ids), names=names)
    if table.has(headings(cell.robot, "q")[0]) or flange_group(table) is not None:  # else the columns that are missing are named first
        complete(table, cell)
    separate = (folder / "centres.csv").exists()
    wide = None if separate else wide_centres(table, cell)
    cell, poses = _read_poses(table, cell, text)
    centres: dict[str, Any]
    if wide is not None:
        centres = wide
    elif all(cell.artefact(cell.stations[s].artefact).is_part for s in np.unique(poses["station"])):
        centres = {"pose": np.zeros(0, int), "ball": np.zeros(0, int), "xyz": np.zeros((0, 3))}
    elif separate:
        centres = _read_centres(read_table(folder / "centres.csv", CENTRES, names=names), cell, poses)
    elif (folder / "scans").is_dir():
        centres = centres_from_scans(folder, cell, poses["pose_id"], poses["station"])
    else:
        raise ConfigError(
            f"{folder}: there is neither centres.csv nor a folder scans with clouds, and poses.csv has no columns x_mm, y_mm, z_mm; "
            "add one of them"
        )
    extra = {**poses.pop("extra"), **centres.pop("extra", {})}
    obs = Observations(cell=cell, **poses, **centres, images=_images(folder / IMAGES), extra=extra, cell_yaml=text)
    return with_estimated_centres(obs, str(folder / "cell.yaml"))


def _images(path: Path) -> BoardImages | None:
    if not path.is_file():
        return None
    content = read_json(read_bounded(path, MAX_IMAGES), str(path), ANEW)
    return from_document(BoardImages, content, IMAGES_FORMAT, str(path), "description of images", ANEW)


def _read_poses(table: Table, cell: Cell, text: str) -> tuple[Cell, dict[str, Any]]:
    """The cell, with the arm that these poses are of, and the columns of ``Observations``."""
    joints = headings(cell.robot, "q")
    by_flange = flange_columns(table, cell, text)
    if by_flange is None:
        table.require(["pose", "station", *joints])
        q = read_joints(table, cell.robot, "q")
        assert q is not None, "required"
        if not cell.robot.chain.sliding:
            refuse_radians(table, table.numbers(joints))
    else:
        table.require(["pose", "station"])
        q = by_flange.coordinates(table)
        table.taken |= set(by_flange.names)
        cell = replace(cell, robot=arm_of_flange_poses(cell.robot.name, cell.robot.repeatability_mm, q))
    out: dict[str, Any] = {"pose_id": table.integer("pose"), "q": q}
    _refuse_repeated(table, "pose", out["pose_id"], "pose {} appears twice (first in line {}); number each pose once")
    stations = {station.id: i for i, station in enumerate(cell.stations)}
    out["station"] = _look_up(table, "station", stations, "station '{}' is not in cell.yaml (there: {})")
    if table.has(["phase"]):
        out["phase"] = np.array([cell.strip() for cell in table.text("phase")], dtype=np.str_)
    if table.has("time_s"):
        out["time_s"] = table.time("time_s")
    if table.has(["sensor_time_s", *FLANGE_VELOCITY]):
        out["sensor_time_s"] = table.number("sensor_time_s")
        linear, turning = (table.numbers(FLANGE_VELOCITY[k : k + 3], angle=k > 0) for k in (0, 3))
        out["flange_velocity"] = np.concatenate([linear, turning], axis=1)
    if table.has("payload_kg"):
        out["payload_kg"] = table.number("payload_kg")
    if by_flange is None:
        out |= _of_joints(table, cell.robot, q, out.get("time_s"))
    out["temperatures"] = {name: table.number(name) for name in table.columns if name.endswith("_C") and name not in table.taken}
    out["extra"] = {f"poses.{name}": cells for name, cells in table.rest().items()}
    return cell, out


def _of_joints(table: Table, robot: RobotModel, q: np.ndarray, time_s: np.ndarray | None) -> dict[str, Any]:
    """Columns of the joints beside their positions."""
    out: dict[str, Any] = {}
    if table.has(names := headings(robot, "dir")):
        out["direction"] = np.zeros(q.shape, dtype=np.int64)
        out["direction"][:, robot.counted] = np.stack([_direction(table, name) for name in names], axis=1)
    else:
        out["movement"] = _movement(q, time_s)
    for name, quantity in (("velocity", "qd"), ("torque", "tau"), ("current", "i")):
        if table.has(headings(robot, quantity)):
            out[name] = read_joints(table, robot, quantity)
    return out


def _read_centres(table: Table, cell: Cell, poses: dict[str, Any]) -> dict[str, Any]:
    if not table.has("ball") and len(cell.ball_ids) == 1:
        table.columns["ball"] = (str(cell.ball_ids[0]),) * len(table)
    table.require(["pose", "ball", *XYZ])
    pose_index = {pose: i for i, pose in enumerate(poses["pose_id"].tolist())}
    pose = _match(table, "pose", table.integer("pose"), pose_index, "pose {} is not in poses.csv")
    balls = {ball: i for i, ball in enumerate(cell.ball_ids)}
    ball = _match(table, "ball", table.integer("ball"), balls, "ball {} is on no artefact of cell.yaml")
    artefacts = {artefact.id: i for i, artefact in enumerate(cell.artefacts)}
    of_station = np.array([artefacts[station.artefact] for station in cell.stations])[poses["station"][pose]]
    wrong = cell.ball_artefact[ball] != of_station
    if wrong.any():
        row = int(np.argmax(wrong))
        station = cell.stations[poses["station"][pose[row]]]
        raise ConfigError(
            f"{table.where(row, 'ball')}: ball {cell.ball_ids[ball[row]]} is not on artefact '{station.artefact}', "
            f"which stands at station '{station.id}' of pose {poses['pose_id'][pose[row]]}; correct the ball or the station"
        )
    _refuse_repeated(table, "ball", pose * len(cell.ball_ids) + ball, "this ball was already given for this pose (line {1}); remove one")
    out: dict[str, Any] = {"pose": pose, "ball": ball, "xyz": table.numbers(XYZ)}
    if table.has(["n_points"]):
        values = table.number("n_points")
        whole = np.array_equal(values, np.rint(values)) and np.abs(values).max(initial=0.0) < 2.0**53
        out["n_points"] = values.astype(np.int64) if whole else values
    if table.has(["rms_mm"]):
        out["rms_mm"] = table.number("rms_mm")
    extra = {}
    if any(table.has(name) for name in QUATERNION):
        table.require(QUATERNION)
        # The text is kept as well: a matrix does not remember the digits of its quaternion.
        extra = {name: np.array(table.text(name), dtype=np.str_) for name in QUATERNION}
        out["rotation"] = rotations(table)
    elif (target := target_columns(table)) is not None and target.rotation:
        out["rotation"] = target.transforms(table)[:, :3, :3]
        table.taken |= set(target.rotation)
    width = 6 if "rotation" in out else 3
    stated = {"covariance": covariances.read(table, width), "shared": covariances.read_shared(table, width)}
    out |= {name: values for name, values in stated.items() if values is not None}
    extra |= table.rest()
    order = np.argsort(pose, kind="stable")
    out = {name: values[order] for name, values in out.items()}
    out["extra"] = {f"centres.{name}": cells[order] for name, cells in extra.items()}
    return out


def _movement(q: np.ndarray, time_s: np.ndarray | None) -> np.ndarray:
    """(P, n) rad: joint angles (P, n) less those of the pose before, in the order of time or as listed; zero at the first pose."""
    order = np.arange(len(q)) if time_s is None else np.argsort(time_s, kind="stable")
    out = np.zeros(q.shape)
    out[order[1:]] = np.diff(q[order], axis=0)
    return out


def _direction(table: Table, name: str) -> np.ndarray:
    values = table.integer(name)
    if (np.abs(values) > 1).any():
        row = int(np.argmax(np.abs(values) > 1))
        raise ConfigError(f"{table.where(row, name)}: '{table.text(name)[row]}' is not -1, 0 or 1; correct it")
    return values


def _look_up(table: Table, column: str, index: dict[str, int], message: str) -> np.ndarray:
    cells = [cell.strip() for cell in table.text(column)]
    return _match(table, column, cells, index, message)


def _match(table: Table, column: str, cells: Sequence | np.ndarray, index: dict, message: str) -> np.ndarray:
    cells = cells.tolist() if isinstance(cells, np.ndarray) else cells
    try:
        return np.array([index[cell] for cell in cells], dtype=np.int64)
    except KeyError:
        row = next(i for i, cell in enumerate(cells) if cell not in index)
        known = ", ".join(map(str, list(index)[:12])) + (", ..." if len(index) > 12 else "")
        raise ConfigError(f"{table.where(row, column)}: {message.format(cells[row], known)}; correct it") from None


def _refuse_repeated(table: Table, column: str, keys: np.ndarray, message: str) -> None:
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    again = first[inverse] != np.arange(len(keys))
    if again.any():
        row = int(np.argmax(again))
        raise ConfigError(f"{table.where(row, column)}: " + message.format(keys[row], table.line[first[inverse[row]]]))
