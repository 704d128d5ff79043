"""Where a motion may end: what every robot refuses before it moves anything."""

from __future__ import annotations

import numpy as np

from mbcacq.errors import ConfigError, SafetyStop
from mbcacq.quantities import in_degrees

_ROUNDING_RAD = 1e-10


def joint_target(robot: str, q: np.ndarray, limits: np.ndarray, where: str = "joint limits") -> np.ndarray:
    """A target that was seen to be within the limits.

    Parameters
    ----------
    robot : str
        How messages name the robot, e.g. "robot 'arm'".
    q : ndarray
        (n,) rad, as somebody asks for it.
    limits : ndarray
        (n, 2) rad.
    where : str
        What the limits are, for the message.

    Returns
    -------
    ndarray
        (n,) rad.

    Raises
    ------
    ConfigError
        Another number of axes.
    SafetyStop
        An axis outside its limits, or no number.
    """
    target, (low, high) = np.asarray(q, dtype=float), limits.T
    if target.shape != low.shape:
        raise ConfigError(f"{robot}: a target has {len(low)} axes, not {np.shape(q)}")
    outside = ~(np.isfinite(target) & (target >= low - _ROUNDING_RAD) & (target <= high + _ROUNDING_RAD))
    if outside.any():
        axis = int(np.argmax(outside))
        angle, (least, most) = in_degrees(target[axis]), in_degrees(limits[axis]).round(2)
        raise SafetyStop(f"{robot}: A{axis + 1} would go to {angle:.3f}°, outside the {where} {least:g}..{most:g}°; nothing was moved")
    return target
