"""Our regressor against Pinocchio, the field's library, on arms with full inertia tensors."""

import numpy as np
import pytest
from test_chain import KR10

from mbcacq.geometry.dynamics import regressor

pin = pytest.importorskip("pinocchio")
if not hasattr(pin, "rnea"):
    pytest.skip("this is not the pinocchio of robotics", allow_module_level=True)


def placed(theta, d, a, alpha, beta):
    """Rz(theta) and the rest of a row, as two placements in m."""
    turn = pin.SE3(pin.utils.rotate("z", theta), np.zeros(3))
    along = pin.SE3(np.eye(3), np.array([a, 0.0, d]) * 1e-3)
    return turn, along * pin.SE3(pin.utils.rotate("x", alpha) @ pin.utils.rotate("y", beta), np.zeros(3))


def reference(mass, com, inertia, down):
    """Links as Pinocchio bodies: com (m) and inertia about it, in the frame behind each row."""
    model = pin.Model()
    model.gravity.linear = 9.80665 * down
    joint, after = 0, pin.SE3.Identity()
    for i, row in enumerate(KR10.rows):
        turn, rest = placed(*row)
        joint = model.addJoint(joint, pin.JointModelRZ(), after * turn, f"A{i + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(mass[i], com[i], inertia[i]), rest)
        after = rest
    return model


def test_torque_of_any_motion():
    rng = np.random.default_rng(5)
    mass, com = rng.uniform(1, 20, 6), rng.normal(0, 0.1, (6, 3))
    root = rng.normal(size=(6, 3, 3)) * 0.3
    inertia = root @ np.swapaxes(root, 1, 2)
    down = np.array([0.3, -0.2, -0.93])
    down /= np.linalg.norm(down)
    model = reference(mass, com, inertia, down)
    data = model.createData()
    q, qd, qdd = (rng.uniform(-2, 2, (20, 6)) for _ in range(3))
    about_origin = inertia + mass[:, None, None] * ((com**2).sum(1)[:, None, None] * np.eye(3) - com[:, :, None] * com[:, None, :])
    upper = about_origin[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    parameters = np.concatenate([mass[:, None], mass[:, None] * com, upper], axis=1)
    ours = np.einsum("tjlk,lk->tj", regressor(KR10, q, qd, qdd, down), parameters)
    s = KR10.sign
    theirs = np.array([s * pin.rnea(model, data, s * a, s * b, s * c) for a, b, c in zip(q, qd, qdd, strict=True)])
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
