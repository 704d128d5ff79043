"""``scans/POSE.ply`` of an observation set: ball centres from clouds where another lab gives no centres, and clouds written."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError, DeviceFault
from mbcacq.files.atomic_write import write_file
from mbcacq.files.stated_unit import in_words
from mbcacq.model.cell import Artefact, Cell
from mbcacq.spheres import ply
from mbcacq.spheres.cloud_file import UNITS_MM
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.ply import centres_from_ply, read_cloud

TRIED = 5  # clouds without a ball that are looked at in other units


def centres_from_scans(folder: Path, cell: Cell, pose_id: np.ndarray, station: np.ndarray) -> dict[str, np.ndarray]:
    """Centre columns of ``Observations`` from the cloud of each pose; a pose without cloud, or without a ball in it, has none.

    pose_id: (P,); station: (P,) index into ``cell.stations``. Raises ConfigError naming the cloud that cannot be used.
    """

    index = {ball: i for i, ball in enumerate(cell.ball_ids)}
    pose, ball, xyz, count, rms = [], [], [], [], []
    blind: dict[Path, Artefact] = {}
    for p, number in enumerate(pose_id.tolist()):
        path = folder / "scans" / f"{number}.ply"
        if not path.exists():
            continue
        artefact = cell.artefact(cell.stations[station[p]].artefact)
        if artefact.is_part:
            continue
        try:
            found = centres_from_ply(path, artefact)
        except DeviceFault as error:
            _refuse_other_unit(path, artefact)
            raise ConfigError(f"{path}: {error}") from None
        if not len(found.ball):
            blind[path] = artefact
        pose.append(np.full(len(found.ball), p))
        ball.append([index[b] for b in found.ball.tolist()])
        xyz.append(found.xyz)
        count.append(found.n_points)
        rms.append(found.rms_mm)
    if not any(map(len, pose)):
        for path, artefact in list(blind.items())[:TRIED]:
            _refuse_other_unit(path, artefact)
        raise ConfigError(f"{folder / 'scans'}: no cloud of a pose (POSE.ply) shows a ball; name each cloud by the number of its pose")
    return {
        "pose": np.concatenate(pose),
        "ball": np.concatenate(ball).astype(np.int64),
        "xyz": np.concatenate(xyz),
        "n_points": np.concatenate(count),
        "rms_mm": np.concatenate(rms),
    }


def _refuse_other_unit(path: Path, artefact: Artefact) -> None:
    """Raise ConfigError naming the unit in which a cloud that shows no ball of the artefact in mm shows some."""

    points = read_cloud(path)
    for unit, factor in UNITS_MM.items():
        try:
            seen = 0 if unit == "mm" else len(find_spheres(factor * points, artefact).ball)
        except DeviceFault:
            seen = 0
        if seen:
            named = in_words(unit)
            raise ConfigError(f"{path}: shows no ball read in mm and {seen} read in {named}; convert the clouds from {named} to mm")


def write_ply(path: Path, points: np.ndarray, intensity: np.ndarray | None = None, simulated: bool = False) -> None:
    """Write ``ply_content`` whole. Raises RecordingError."""
    write_file(path, ply_content(points, intensity, simulated))


def ply_content(points: np.ndarray, intensity: np.ndarray | None = None, simulated: bool = False) -> bytes:
    """Binary PLY: points (N, 3) as float32 or float64, mm; intensity (N,) uint8 as a property of its own. simulated: a comment
    says so."""
    kind = "<f8" if points.dtype == np.float64 else "<f4"
    columns = {axis: points[:, i].astype(kind) for i, axis in enumerate("xyz")}
    if intensity is not None:
        columns["intensity"] = np.asarray(intensity, dtype=np.uint8)
    return ply.ply_content(columns, ["simulated: true"] if simulated else [])
