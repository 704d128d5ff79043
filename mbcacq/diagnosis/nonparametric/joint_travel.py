"""Travel of each joint to its pose: lost motion that grease, wind-up or a pre-sliding regime lets fade with the distance travelled."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context


def directions(s: Context) -> np.ndarray:
    """(P, n) direction of rotation of each joint's last motion, as recorded; only asked where it was recorded."""
    assert s.obs.direction is not None, "the recording has directions of rotation"
    return s.obs.direction.astype(float)


def travelled(s: Context) -> tuple[np.ndarray, np.ndarray]:
    """(P, n) rad of each joint's last motion before the pose, and (P, n) its direction of rotation; the first pose came from far away."""
    listed = np.argsort(s.order, kind="stable")
    q, direction = s.obs.q[listed], directions(s)[listed]
    travel = np.full(q.shape, np.inf)
    travel[1:] = np.abs(np.diff(q, axis=0))
    moved = travel > OPTIONS.standing_rad
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q))[:, None], 0), axis=0)
    out = np.empty(q.shape), np.empty(q.shape)
    out[0][listed], out[1][listed] = np.take_along_axis(travel, last, axis=0), np.take_along_axis(direction, last, axis=0)
    return out


def functions(s: Context, i: int) -> np.ndarray:
    """(P, 4): the direction of joint i's last motion, by itself and fading with the distance travelled over each of the reaches."""
    travel, direction = travelled(s)
    fading = [direction[:, i] * np.exp(-travel[:, i] / reach) for reach in OPTIONS.fading_reaches]
    return np.stack([directions(s)[:, i], *fading], axis=1)
