"""The calibrated kinematics as frames of joints that turn about their z: ROS parameters in the form of UR's calibration.yaml, and MJCF."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # half a turn about x: a joint that counts the other way turns about the opposite z


def joint_frames(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Each joint's frame in the one before it, the first in the base: (n, 4, 4); and the flange in the last joint's frame (4, 4).

    Joint i turns about its z by the controller's angle. Of H_i = Rz(q + theta) Tz(d) Tx(a) Rx(alpha) Ry(beta), the part before a joint is
    the last three of the row before and the first two of its own, which do not move with its angle in any other order.
    """
    zero = Chain(chain.sign, chain.theta, chain.d, 0 * chain.a, 0 * chain.alpha, 0 * chain.beta).link_transforms(np.zeros((1, chain.n)))[0]
    rest = Chain(chain.sign, 0 * chain.theta, 0 * chain.d, chain.a, chain.alpha, chain.beta).link_transforms(np.zeros((1, chain.n)))[0]
    flips = [FLIP if sign < 0 else np.eye(4) for sign in chain.sign]
    out, before = [], np.eye(4)
    for i in range(chain.n):
        out.append(before @ zero[i] @ flips[i])
        before = flips[i] @ rest[i]
    return np.array(out), before


def kinematics_yaml(chain: Chain, robot: str = "") -> str:
    """ROS parameters ``kinematics: {LINK: {x, y, z, roll, pitch, yaw}}``, m and rad; a UR arm's links have the names of its description."""
    frames, _ = joint_frames(chain)
    names = UR_LINKS if chain.n == 6 and "UR" in robot else tuple(f"link_{i + 1}" for i in range(chain.n))
    content = {}
    for name, T in zip(names, frames, strict=True):
        (x, y, z), (yaw, pitch, roll) = se3.to_abc(T)
        values = {"x": x / 1e3, "y": y / 1e3, "z": z / 1e3, "roll": roll, "pitch": pitch, "yaw": yaw}
        content[name] = {key: round(float(v), 12) + 0.0 for key, v in values.items()}
    return yaml.safe_dump({"kinematics": content}, sort_keys=False)


def mjcf(chain: Chain, T_flange_scanner: np.ndarray, robot: str = "arm", comments: Sequence[str] = ()) -> str:
    """The arm for MuJoCo: bodies with hinges, sites at flange and scanner. What the calibration knows is geometry; masses, ranges and
    drives are of another file. comments: put in front."""
    frames, flange = joint_frames(chain)
    lines = [
        *(f"<!-- {line.replace('--', '-')} -->" for line in comments),
        f"<mujoco model={quoteattr(robot)}>",
        '  <compiler angle="radian"/>',
        "  <worldbody>",
    ]
    for i, T in enumerate(frames):
        indent = "  " * (i + 2)
        lines += [f'{indent}<body name="link_{i + 1}" {_place(T)}>', f'{indent}  <joint name="joint_{i + 1}" type="hinge" axis="0 0 1"/>']
        lines.append(f'{indent}  <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>')
    indent = "  " * (chain.n + 2)
    lines += [f'{indent}<site name="flange" {_place(flange)}/>', f'{indent}<site name="scanner" {_place(flange @ T_flange_scanner)}/>']
    lines += ["  " * (i + 2) + "</body>" for i in reversed(range(chain.n))]
    return "\n".join([*lines, "  </worldbody>", "</mujoco>"]) + "\n"


def _place(T: np.ndarray) -> str:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    position = " ".join(f"{v / 1e3:.12g}" for v in T[:3, 3])
    return f'pos="{position}" quat="{w:.15g} {x:.15g} {y:.15g} {z:.15g}"'
