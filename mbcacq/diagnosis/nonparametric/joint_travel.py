"""How far each joint came to its pose: lost motion that grease, wind-up or a pre-sliding regime lets fade with the distance travelled."""

from __future__ import annotations

import numpy as np

from mbcacq.effects.context import Context

REACHES = (0.1, 0.3, 1.0)  # rad over which the memory of where a joint came from fades
STANDING = 1e-4  # rad: less than this is no motion, what was before it lasts


def travelled(s: Context) -> tuple[np.ndarray, np.ndarray]:
    """(P, n) rad each joint's last motion before the pose, and (P, n) its sense as recorded; the first pose came from far away."""
    listed = np.argsort(s.order, kind="stable")
    q, sense = s.obs.q[listed], s.obs.direction[listed].astype(float)
    travel = np.full(q.shape, np.inf)
    travel[1:] = np.abs(np.diff(q, axis=0))
    moved = travel > STANDING
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q))[:, None], 0), axis=0)
    out = np.empty(q.shape), np.empty(q.shape)
    out[0][listed], out[1][listed] = np.take_along_axis(travel, last, axis=0), np.take_along_axis(sense, last, axis=0)
    return out


def functions(s: Context, i: int) -> np.ndarray:
    """(P, 4): the sense of joint i's last motion, by itself and fading with the distance travelled over each of the reaches."""
    travel, sense = travelled(s)
    fading = [sense[:, i] * np.exp(-travel[:, i] / reach) for reach in REACHES]
    return np.stack([s.obs.direction[:, i].astype(float), *fading], axis=1)
