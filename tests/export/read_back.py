"""What the exported files say, read by code of the tests: nothing of it is in the program."""

import re

import numpy as np
import yaml
from scipy.spatial.transform import Rotation


def tool_data(text, number):
    """(4, 4) mm of TOOL_DATA[number] in a ``$config.dat``; A about Z, B about the new Y, C about the new X."""
    frame = re.search(rf"^\s*TOOL_DATA\s*\[{number}\]\s*=\s*\{{([^}}]*)\}}", text, re.MULTILINE)[1]
    value = {axis: float(number) for axis, number in (entry.split() for entry in frame.split(","))}
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [value[axis] for axis in "ABC"], degrees=True).as_matrix()
    T[:3, 3] = [value[axis] for axis in "XYZ"]
    return T


def hand_eye(path):
    """(4, 4) mm of a file of easy_handeye2."""
    transform = yaml.safe_load(path.read_text())["transform"]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([transform["rotation"][c] for c in "xyzw"]).as_matrix()
    T[:3, 3] = [1e3 * transform["translation"][c] for c in "xyz"]
    return T
