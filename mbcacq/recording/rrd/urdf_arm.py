"""The arm drawn from a URDF: its meshes and shapes, moved by the controller's joint angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.cell import Cell
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.drawn_later import Stream

INSTEAD = "the arm is drawn from its links instead"
MOVING = ("revolute", "continuous")
SAME_MM = 5.0  # flanges that move apart by more than this belong to different arms


class UrdfArm:
    """Logs the shapes of a URDF once and its joints at every posture. Raises ConfigError if the file does not describe this arm."""

    def __init__(self, path: Path | str, cell: Cell) -> None:
        try:
            self._tree = rr.urdf.UrdfTree.from_file_path(path, entity_path_prefix=layout.URDF)
        except (RuntimeError, ValueError, OSError) as error:
            raise ConfigError(f"{path}: cannot be read as a URDF ({str(error).splitlines()[0]}); {INSTEAD}") from error
        self._joints = [joint for joint in self._tree.joints() if joint.joint_type in MOVING]
        if len(self._joints) != cell.robot.n:
            raise ConfigError(f"{path}: has {len(self._joints)} moving joints, the arm has {cell.robot.n} axes; {INSTEAD}")
        self._check(path, cell)

    def start(self, stream: rr.RecordingStream) -> None:
        """Shapes, and where the URDF's metres stand in the world's millimetres."""
        self._tree.log_urdf_to_recording(stream)
        root = rr.Transform3D(scale=1e3, parent_frame=f"tf#/{layout.WORLD}", child_frame=self._tree.root_link().name)
        stream.log(f"{layout.URDF}/root", root, static=True)

    def pose(self, stream: Stream, q: np.ndarray, index: list | None = None) -> None:
        """Joints at q (k, n) rad: at the times of ``index``, or q (1, n) at the times set on the stream."""
        for i, joint in enumerate(self._joints):
            entity = f"{layout.URDF}/joints/{rr.escape_entity_path_part(joint.name)}"
            if index is None:
                stream.log(entity, joint.compute_transform(float(q[0, i]), clamp=False))
            else:
                stream.send_columns(entity, index, joint.compute_transform_columns(q[:, i].tolist(), clamp=False))

    def _check(self, path: Path | str, cell: Cell) -> None:
        """Whether the last link moves as the flange does: the same up to a fixed frame at either end."""
        rng = np.random.default_rng(0)
        low, high = np.clip(cell.robot.limits, -1.5, 1.5).T
        q = rng.uniform(low, high, size=(12, cell.robot.n))
        ours, theirs = cell.robot.chain.flange(q), self._forward(q)
        steps = [se3.inverse(T[0]) @ T[1:] for T in (ours, theirs)]  # motions relative to the first posture, each in its flange's axes
        angle = [np.arccos(np.clip((np.trace(s[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)) for s in steps]
        if np.abs(angle[0] - angle[1]).max() > 5e-3 or self._apart(ours, theirs) > SAME_MM:
            raise ConfigError(
                f"{path}: its joints do not move as those of {cell.robot.name or 'the arm'}: another robot, or other "
                f"directions of rotation or zeros of the joints; {INSTEAD}"
            )

    @staticmethod
    def _apart(ours: np.ndarray, theirs: np.ndarray) -> float:
        """How far (mm) the flanges stay apart when the last link carries the flange at the best fixed place: theirs + R_theirs p = ours."""
        rows = np.concatenate([theirs[:, :3, :3], np.tile(-np.eye(3), (len(ours), 1, 1))], axis=2).reshape(-1, 6)
        right = (ours[:, :3, 3] - theirs[:, :3, 3]).reshape(-1)
        left = right - rows @ np.linalg.lstsq(rows, right, rcond=None)[0]
        return float(np.abs(left).max())

    def _forward(self, q: np.ndarray) -> np.ndarray:
        """(k, 4, 4) mm: T_root_last, fixed joints in between included."""
        up = {joint.child_link: joint for joint in self._tree.joints()}
        number = {joint.name: i for i, joint in enumerate(self._joints)}
        chain, link = [], self._joints[-1].child_link
        while link in up:
            chain.append(up[link])
            link = up[link].parent_link
        T = np.tile(np.eye(4), (len(q), 1, 1))
        for joint in reversed(chain):
            r, p, y = joint.origin_rpy
            T = T @ se3.from_abc(1e3 * np.array(joint.origin_xyz), np.array([y, p, r]))
            if joint.name in number:
                T = T @ _turned(np.array(joint.axis, dtype=float), q[:, number[joint.name]])
        return T


def _turned(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(k, 4, 4) about an axis (3,)."""
    K = se3.skew((axis / np.linalg.norm(axis))[None])[0]
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, :3, :3] += np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)
    return T
