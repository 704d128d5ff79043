"""A MuJoCo model with what was found written into it: kinematics from a calibrated chain, and the file."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.geometry.chain import Chain
from mbcacq.simulation.mujoco_arm import MujocoArm, addresses, base_body, body_of, frames_at, mujoco_engine


def as_xml(arm: MujocoArm, spec: Any) -> str:
    """A model as MJCF, with its meshes and textures where they are."""
    written = spec.copy()
    folder = arm.path.resolve().parent
    for name, used in (("meshdir", spec.meshes), ("texturedir", spec.textures)):
        if len(used):
            setattr(written, name, str(folder / getattr(spec, name)))
    written.compile()
    return str(written.to_xml())


def body_frames(arm: MujocoArm, spec: Any) -> np.ndarray:
    """(n, 4, 4) mm: the bodies of the axes at joint angles of zero, in the base frame of the imported arm."""
    model = spec.compile()
    bodies = [base_body(arm, model), *(body_of(model, j) for j in arm.joints)]
    world = frames_at(model, bodies, arm.joints, np.zeros((1, arm.n)))[0]
    return np.linalg.inv(world[0]) @ world[1:]


def T_body_link(arm: MujocoArm, axis: int) -> np.ndarray:
    """(4, 4) mm: the frame behind the row of an axis in that axis' body of the model. Both turn with the axis."""
    bodies = body_frames(arm, arm.spec)
    links = arm.imported.T_given_base @ arm.robot.chain.frames(np.zeros((1, arm.n)))[0][1:]
    return np.linalg.inv(bodies[axis]) @ links[axis]


def with_chain(arm: MujocoArm, chain: Chain) -> Any:
    """The model whose joints lie as those of a calibrated chain: places of bodies and axes of joints."""
    spec = arm.spec.copy()
    old = body_frames(arm, arm.spec)
    T_base = arm.imported.T_given_base
    zero = np.zeros((1, arm.n))
    before, after = (T_base @ c.frames(zero)[0] for c in (arm.robot.chain, chain))
    new = after[1:] @ np.linalg.inv(before[1:]) @ old  # each body rides on the frame behind its row as it did
    model = arm.spec.compile()
    reference = model.qpos0[addresses(model, arm.joints)[0]]
    rows = T_base @ chain.frames(reference[None])[0]  # the frame before the row of each axis, whose z is the axis
    turned = rows[1:] @ np.linalg.inv(after[1:]) @ new if reference.any() else new
    place = np.eye(4)
    for k, joint in enumerate(arm.joints):
        body = spec.joint(joint).parent
        own = np.linalg.inv(_between(arm, model, k)) @ np.linalg.inv(place) @ turned[k]
        body.pos, body.quat = 1e-3 * own[:3, 3], _quaternion(own[:3, :3])
        body.alt.type = mujoco_engine().mjtOrientation.mjORIENTATION_QUAT
        inside = np.linalg.inv(turned[k]) @ rows[k]
        for one in body.joints:
            one.axis, one.pos = inside[:3, 2] * chain.sign[k], 1e-3 * _nearest(inside, 1e3 * np.array(one.pos))
        place = turned[k]
    return spec


def _nearest(frame: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The point of the frame's z axis that is nearest to a point."""
    z, origin = frame[:3, 2], frame[:3, 3]
    return origin + z * (z @ (point - origin))


def _between(arm: MujocoArm, model: Any, k: int) -> np.ndarray:
    """(4, 4) mm: the frame in which the body of an axis is placed, in the body of the axis before (of the first: in the base)."""
    before = body_of(model, arm.joints[k - 1]) if k else base_body(arm, model)
    parent = int(model.body_parentid[body_of(model, arm.joints[k])])
    world = frames_at(model, (before, parent), (), np.zeros((1, 0)))[0]
    return np.linalg.inv(world[0]) @ world[1]


def _quaternion(R: np.ndarray) -> np.ndarray:
    out = np.zeros(4)
    mujoco_engine().mju_mat2Quat(out, np.ascontiguousarray(R).ravel())
    return out
