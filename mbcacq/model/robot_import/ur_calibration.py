"""The factory calibration of a UR arm as its ROS driver extracts it: ``kinematics: {shoulder: {x, y, z, roll, pitch, yaw}, ..}``.

Each entry is the frame of a joint in the one before it, the first in the controller's base, m and rad; the joint turns about its own z. A
line ``hash: calib_..`` names the calibration: the driver compares it with the arm's.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.robot_import.source import ArmSource

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
VALUES = ("x", "y", "z", "roll", "pitch", "yaw")
LARGEST = 1e6  # of any entry: a whole number of 400 digits is no float, and neither is a nan
LONGEST_M = 3.0  # of a link: the largest UR reaches 1.75 m; beyond, the numbers are millimetres


def is_ur_calibration(content: object) -> bool:
    """Whether the content of a YAML file is one."""
    kinematics = content.get("kinematics") if isinstance(content, Mapping) else None
    return isinstance(kinematics, Mapping) and set(LINKS) <= set(kinematics)


def read_ur_calibration(path: Path, content: Mapping[str, Any]) -> ArmSource:
    """The arm of a calibration file. Raises ConfigError for an entry that is missing, no number, or not in metres."""
    kinematics = content["kinematics"]
    before = np.array([_frame(path, link, kinematics[link]) for link in LINKS])
    at_zero = _chained(before, np.zeros((1, len(LINKS))))[0]
    unknown = np.full((len(LINKS), 2), np.nan)
    found = kinematics.get("hash")
    remarks = [f"the factory calibration {found}; the driver of ROS asks for this line again" if found else "the file names no hash"]
    return ArmSource(
        name=path.stem,
        base="base",
        flange="tool0",
        joints=("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
        direction=at_zero[:, :3, 2],
        point=at_zero[:, :3, 3],
        T_base_flange=at_zero[-1],
        limits=unknown,
        speed=unknown[:, 0],
        mass=np.zeros(len(LINKS)),
        com=np.zeros((len(LINKS), 3)),
        forward=lambda q: _chained(before, q)[:, -1],
        remarks=remarks,
    )


def _frame(path: Path, link: str, entry: object) -> np.ndarray:
    """(4, 4) of one entry, in mm: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    values = [entry.get(key) for key in VALUES] if isinstance(entry, Mapping) else [None]
    if any(isinstance(v, bool) or not isinstance(v, int | float) or not abs(v) <= LARGEST for v in values):
        raise ConfigError(f"{path}: kinematics.{link}: needs the numbers {', '.join(VALUES)}; write the file anew with ur_calibration")
    x, y, z, roll, pitch, yaw = (float(v) for v in values if isinstance(v, int | float))
    if max(abs(x), abs(y), abs(z)) > LONGEST_M:
        raise ConfigError(f"{path}: kinematics.{link}: a link of {max(abs(x), abs(y), abs(z)):g} m; the file's lengths are in metres")
    return se3.from_abc(1e3 * np.array([x, y, z]), np.array([yaw, pitch, roll]))


def _chained(before: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(P, n, 4, 4): the frame of each joint, turned by its angle, in the base."""
    out, T = [], np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for frame, angle in zip(before, q.T, strict=True):
        turn = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
        turn[:, 0, 0], turn[:, 0, 1] = np.cos(angle), -np.sin(angle)
        turn[:, 1, 0], turn[:, 1, 1] = np.sin(angle), np.cos(angle)
        T = T @ frame @ turn
        out.append(T)
    return np.stack(out, axis=1)
