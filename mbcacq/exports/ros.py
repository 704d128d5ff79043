"""ROS 2: the hand-eye calibration as easy_handeye2 keeps it, and a static transform as launch file and command.

Metres; quaternions x y z w.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import orientations
from mbcacq.model import yaml12
from mbcacq.recording.datasets import quaternions


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
    return yaml12.dump(data)


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


def urdf_fragment(T: np.ndarray, parent: str = "tool0", child: str = "scanner_frame", comments: Sequence[str] = ()) -> str:
    """Link and fixed joint of the frame, for a xacro to include (``xacro:include``) or to be copied into a URDF; fixed axes."""
    xyz, (roll, pitch, yaw) = _metres(T)[:3], orientations.to_numbers(np.asarray(T, dtype=float)[None, :3, :3], "xyz")[0]
    origin = f'xyz="{" ".join(f"{v:.10g}" for v in xyz)}" rpy="{roll:.12g} {pitch:.12g} {yaw:.12g}"'
    said = "".join(f"  <!-- {line.replace('--', '- -')} -->\n" for line in comments)
    return f"""<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
{said}  <link name="{_frame(child)}"/>
  <joint name="{_frame(child)}_mount" type="fixed">
    <parent link="{_frame(parent)}"/>
    <child link="{_frame(child)}"/>
    <origin {origin}/>
  </joint>
</robot>
"""


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
