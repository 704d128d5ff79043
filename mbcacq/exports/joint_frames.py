"""The calibrated kinematics as frames of joints that turn about their z, and as ROS parameters in the form of UR's calibration.yaml."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model import yaml12

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # half a turn about x: a joint that counts the other way turns about the opposite z


def joint_frames(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Each joint's frame in the one before it, the first in the base: (n, 4, 4); and the flange in the last joint's frame (4, 4).

    Joint i turns about its z by the controller's angle, or slides along it. A row is
    H_i = Rz(q + theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). The
    part before a joint is the last three factors of the row before and the first two of its own, which do not move with its angle in any
    other order.
    """
    zero = chain.with_rows(chain.rows * [1, 1, 0, 0, 0]).link_transforms(np.zeros((1, chain.n)))[0]
    behind = behind_joints(chain)
    before = np.concatenate([(np.eye(4) if chain.root is None else chain.root)[None], behind[:-1]])
    return before @ zero @ _flips(chain), behind[-1]


def behind_joints(chain: Chain) -> np.ndarray:
    """(n, 4, 4): the frame behind each row, of the link, in the frame of its joint."""
    rest = chain.with_rows(chain.rows * [0, 0, 1, 1, 1]).link_transforms(np.zeros((1, chain.n)))[0]
    return _flips(chain) @ rest


def _flips(chain: Chain) -> np.ndarray:
    return np.array([FLIP if sign < 0 else np.eye(4) for sign in chain.sign])


def kinematics_yaml(chain: Chain, robot: str = "") -> str:
    """ROS parameters ``kinematics: {LINK: {x, y, z, roll, pitch, yaw}}``, m and rad; a UR arm's links have the names of its description."""
    frames, _ = joint_frames(chain)
    names = UR_LINKS if chain.n == 6 and "UR" in robot else tuple(f"link_{i + 1}" for i in range(chain.n))
    content = {}
    for name, T in zip(names, frames, strict=True):
        (x, y, z), (yaw, pitch, roll) = se3.to_abc(T)
        values = {"x": x / 1e3, "y": y / 1e3, "z": z / 1e3, "roll": roll, "pitch": pitch, "yaw": yaw}
        content[name] = {key: round(float(v), 12) + 0.0 for key, v in values.items()}
    return yaml12.dump({"kinematics": content})
