"""ROS 2: the hand-eye calibration as easy_handeye2 keeps it, and a static transform as launch file and command.

Metres; quaternions x y z w.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import read_bounded
from mbcacq.model import yaml12
from mbcacq.recording.datasets import quaternions

MAX_BYTES = 1 << 20


def hand_eye_yaml(
    T: np.ndarray,
    *,
    name: str,
    base: str = "base_link",
    flange: str = "tool0",
    scanner: str = "scanner_frame",
    artefact: str = "artefact",
    fixed: bool = False,
) -> str:
    """Text of ``~/.ros2/easy_handeye2/calibrations/NAME.calib``.

    T: (4, 4) mm, T_flange_scanner of a scanner on the flange; ``fixed``: T_base_scanner of one that stands in the base.
    """
    x, y, z, qx, qy, qz, qw = _metres(T)
    data = {
        "parameters": {
            "name": name,
            "calibration_type": "eye_on_base" if fixed else "eye_in_hand",
            "robot_base_frame": base,
            "robot_effector_frame": flange,
            "tracking_base_frame": scanner,
            "tracking_marker_frame": artefact,
            "freehand_robot_movement": False,
        },
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw}},
    }
    return yaml.safe_dump(data, sort_keys=False)


def read_hand_eye(path: str | Path) -> np.ndarray:
    """T_flange_scanner (4, 4) mm from an easy_handeye2 file, or from the older flat form. Raises ConfigError naming the file."""
    path = Path(path)
    try:
        text = read_bounded(path, MAX_BYTES)
        if len(text) > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; this is no hand-eye calibration")
        data: Any = yaml12.load(text.decode("utf-8"))
        if "transform" in data:
            t, r = data["transform"]["translation"], data["transform"]["rotation"]
            value = [t["x"], t["y"], t["z"], r["w"], r["x"], r["y"], r["z"]]
        else:
            flat = data["transformation"]
            value = [flat[k] for k in ("x", "y", "z", "qw", "qx", "qy", "qz")]
        number = np.array(value, dtype=float)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: is not a hand-eye calibration of easy_handeye2 (transform: translation, rotation)") from error
    if not np.isfinite(number).all() or abs(np.linalg.norm(number[3:]) - 1) > 1e-3:
        raise ConfigError(f"{path}: the rotation is not a unit quaternion")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = quaternions.to_matrix(number[3:]), 1e3 * number[:3]
    return T


def static_transform_command(T: np.ndarray, parent: str = "tool0", child: str = "scanner_frame") -> str:
    """One line for a shell."""
    return "ros2 run tf2_ros static_transform_publisher " + " ".join(_arguments(T, parent, child))


def launch_file(T: np.ndarray, parent: str = "tool0", child: str = "scanner_frame") -> str:
    """Text of a ``.launch.py`` that publishes the transform."""
    listed = ",\n            ".join(repr(a) for a in _arguments(T, parent, child))
    return f'''"""Static transform {_frame(parent)} to {_frame(child)}, calibrated by mbcacq."""

from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription([
        Node(package="tf2_ros", executable="static_transform_publisher", arguments=[
            {listed},
        ]),
    ])
'''


def _arguments(T: np.ndarray, parent: str, child: str) -> list[str]:
    names = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")
    values = [part for name, v in zip(names, _metres(T), strict=True) for part in (name, f"{v:.10g}")]
    return ["--frame-id", _frame(parent), "--child-frame-id", _frame(child), *values]


def _metres(T: np.ndarray) -> list[float]:
    w, x, y, z = quaternions.from_matrix(np.asarray(T, dtype=float)[:3, :3])
    return [float(v) for v in (*(np.asarray(T)[:3, 3] / 1e3), x, y, z, w)]


def _frame(name: str) -> str:
    if not name or not all(c.isalnum() or c in "_/-" for c in name):
        raise ConfigError(f"{name!r} is not a name of a ROS frame; use letters, digits, _ and /")
    return name
