"""An arm as capsules along its MD-H rows, for every picture of it: each link goes along its z by d, then along its x by a."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

SHOULDER, WRIST = 0.042, 0.42  # radius of the first link of the reach; of the last link of that of the first


def link_radii(chain: Chain) -> np.ndarray:
    """(m,) mm, from shoulder to wrist, of the m joints from the floor on: those that carry the artefact have a shape that nobody stated."""
    reach = np.hypot(chain.a, chain.d)[chain.floor :]
    return SHOULDER * float(np.sum(reach)) * np.linspace(1.0, WRIST, len(reach))


def link_corners(chain: Chain) -> np.ndarray:
    """(n, 3, 3) mm: where the axis of each link begins, bends and ends, in the link's own frame."""
    step = se3.inverse(chain.link_transforms(-chain.sign * chain.theta[None])[0])  # joint turned to zero: the rigid part of each row
    zero = np.zeros(chain.n)
    corners = np.stack([np.column_stack(xyz) for xyz in ((zero, zero, zero), (zero, zero, chain.d), (chain.a, zero, chain.d))], axis=1)
    return se3.apply(step[:, None], corners)


def arm_outline(chain: Chain, q: np.ndarray, of_foot: bool = False) -> np.ndarray:
    """(3 m, 3) mm in the base: the corners of the links of ``link_radii`` at joint angles q (n,) rad. of_foot: in the frame of the arm's
    foot, which stands where it is while a table turns."""
    frames = chain.frames(q[None])[0]
    if of_foot:
        frames = se3.inverse(frames[chain.floor]) @ frames
    return se3.apply(frames[1:, None], link_corners(chain))[chain.floor :].reshape(-1, 3)
