"""The arm's links as a MuJoCo model; mass matrix and bias torque with the controller's signs. Lengths m, angles rad."""

from __future__ import annotations

from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from mbcacq.errors import ConfigError

GRAVITY = 9.80665


def mujoco() -> Any:
    """The engine. Raises ConfigError where it is not installed."""
    try:
        import mujoco as engine  # pyright: ignore[reportMissingImports]  # an extra, for the moving arm alone
    except ImportError as error:
        raise ConfigError("the moving fake arm needs MuJoCo; install it with: pip install 'mbcacq[dev]'") from error
    return engine


class Bodies:
    """Serial chain from rows (n, 5: theta rad, d mm, a mm, alpha rad, beta rad), sign (n,), mass (n,) kg, com (n, 3) mm in the link.

    payload (kg, com (3,) mm in the flange frame) rides on the last link. Inertia tensors are those of solid boxes of the links' size.
    """

    def __init__(
        self, sign: np.ndarray, rows: np.ndarray, mass: np.ndarray, com: np.ndarray, payload: tuple[float, np.ndarray], gravity: np.ndarray
    ) -> None:
        self._engine = mujoco()
        self.n = len(sign)
        self.model = self._engine.MjModel.from_xml_string(_xml(sign, rows, mass, com, payload, gravity))
        self.data = self._engine.MjData(self.model)
        self._full = np.zeros((self.n, self.n))

    def at(self, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mass matrix (n, n) and torque (n,) that gravity, centrifugal and Coriolis forces ask of the drives. The arrays are reused."""
        engine, model, data = self._engine, self.model, self.data
        data.qpos[:], data.qvel[:] = q, qd
        engine.mj_fwdPosition(model, data)
        engine.mj_fwdVelocity(model, data)
        engine.mj_fullM(model, data, self._full)
        return self._full, data.qfrc_bias


def _xml(sign, rows, mass, com, payload, gravity) -> str:
    parts, close = [], []
    frame = np.eye(4)  # where the previous link's own frame lies in its body
    for i, (theta, d, a, alpha, beta) in enumerate(np.asarray(rows, dtype=float)):
        start = frame @ _rigid("Z", theta, np.zeros(3))
        after = _rigid("XY", (alpha, beta), np.array([a, 0.0, d]) * 1e-3)
        size = np.maximum(np.abs([a, 0.0, d]) / 1000, 0.12)
        bodies = _mass(mass[i], after, np.asarray(com[i]) * 1e-3, size, f"link{i + 1}")
        if i == len(rows) - 1 and payload[0] > 0:
            bodies += _mass(payload[0], after, np.asarray(payload[1]) * 1e-3, np.full(3, 0.08), "tool")
        # With theta taken into the body's own frame the joint is zero where the controller's is.
        parts.append(
            f'<body name="b{i + 1}" pos="{_v(start[:3, 3])}" quat="{_v(_quat(start[:3, :3]))}">'
            f'<joint name="A{i + 1}" type="hinge" axis="0 0 {int(sign[i])}"/>{bodies}'
        )
        close.append("</body>")
        frame = after
    down = GRAVITY * np.asarray(gravity, dtype=float)
    return (
        f'<mujoco><option gravity="{_v(down)}"/><compiler angle="radian" inertiafromgeom="false" boundmass="1e-6" boundinertia="1e-9"/>'
        f"<worldbody>{''.join(parts)}{''.join(close)}</worldbody></mujoco>"
    )


def _mass(mass: float, T: np.ndarray, com: np.ndarray, size: np.ndarray, name: str) -> str:
    """A massive box: its centre ``com`` in a frame that lies at T in the body."""
    x, y, z = size
    inertia = mass / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    place = T[:3, :3] @ com + T[:3, 3]
    return (
        f'<body name={quoteattr(name)} pos="{_v(place)}" quat="{_v(_quat(T[:3, :3]))}">'
        f'<inertial pos="0 0 0" mass="{max(mass, 1e-3):.17g}" diaginertia="{_v(np.maximum(inertia, 1e-8))}"/></body>'
    )


def _v(values) -> str:
    return " ".join(f"{v:.17g}" for v in np.asarray(values, dtype=float))


def _rigid(axes: str, angles: Any, xyz: np.ndarray) -> np.ndarray:
    """Turned about its own axes, one after the other, at xyz."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler(axes, angles).as_matrix(), xyz
    return T


def _quat(R: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(R).as_quat(scalar_first=True)
