"""Corners of square markers where straight lines through their edges meet.

A corner itself is a poor place: blur rounds it and moves it inwards, by about a third of the blur's sigma, and every marker then looks
smaller and farther. The edge between black and white stays where it is.
"""

from __future__ import annotations

import numpy as np

from mbcacq.camera.intrinsics import Intrinsics

ALONG = np.linspace(0.12, 0.88, 24)  # places on a side, away from its corners
REACH = 0.09  # half the length of a profile across an edge over the marker's side: the black border is an eighth of it or more wide
STEPS = 25  # samples of a profile
LEAST_CONTRAST = 20.0  # grey levels


def corners_of_edges(grey: np.ndarray, corners: np.ndarray, lens: Intrinsics | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Corners refined by the lines of the four edges.

    Parameters
    ----------
    grey : (H, W) ndarray
        uint8.
    corners : (M, 4, 2) ndarray
        First guesses in px, clockwise, within two pixels.
    lens : Intrinsics or None
        By whose distortion edges are bent; None: not known yet.

    Returns
    -------
    tuple of ndarray
        Corners (M, 4, 2) px, and whether all edges of a marker were found (M,).
    """
    uv, good = lens.straightened(corners) if lens else corners, np.ones(len(corners), dtype=bool)
    for _ in range(2):
        uv, good = _refined(grey, uv, lens)
    uv = lens.distorted(uv) if lens else uv
    return uv, good & (np.abs(uv - corners).max(axis=(1, 2), initial=0.0) < 4.0)


def _refined(grey: np.ndarray, corners: np.ndarray, lens: Intrinsics | None) -> tuple[np.ndarray, np.ndarray]:
    side = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(side, axis=2, keepdims=True)
    outwards = np.stack([side[..., 1], -side[..., 0]], axis=-1) / length
    reach = np.maximum(REACH * length.min(axis=1, keepdims=True), 2.0)
    offset = np.linspace(-1.0, 1.0, STEPS) * reach  # (M, 1, STEPS)
    on_side = corners[:, :, None] + ALONG[:, None] * side[:, :, None]
    at = on_side[:, :, :, None] + offset[:, :, None, :, None] * outwards[:, :, None, None]
    profile = _sampled(grey, lens.distorted(at) if lens else at)  # (M, 4, A, STEPS): dark, then light
    ends = max(STEPS // 6, 1)
    dark, light = np.median(profile[..., :ends], axis=-1), np.median(profile[..., -ends:], axis=-1)
    # The share of the profile that is dark says where the step is, whatever the blur (as long as the profile holds all of it).
    step = 2 * reach[..., None] / (STEPS - 1)
    share = np.clip((light[..., None] - profile) / np.maximum(light - dark, 1.0)[..., None], -0.5, 1.5)
    edge = step[..., 0] * (share.sum(axis=-1) - 0.5 * (share[..., 0] + share[..., -1])) - reach
    clear = light - dark > LEAST_CONTRAST
    offset_along = _line_through(np.broadcast_to(ALONG, edge.shape), edge, clear.astype(float))
    intercept, slope = np.moveaxis(offset_along, -1, 0)[..., None]
    start = corners + intercept * outwards
    direction = side + slope * outwards
    # Corner k is where the line of side k - 1 meets that of side k.
    before, along = np.roll(start, 1, axis=1), np.roll(direction, 1, axis=1)
    cross = along[..., 0] * direction[..., 1] - along[..., 1] * direction[..., 0]
    gap = start - before
    t = (gap[..., 0] * direction[..., 1] - gap[..., 1] * direction[..., 0]) / np.where(np.abs(cross) < 1e-9, 1e-9, cross)
    return before + t[..., None] * along, (clear.sum(axis=2) >= len(ALONG) / 2).all(axis=1)


def _line_through(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(..., 2) intercept and slope through (..., A) points; points that are off by more than three times the usual are left out."""
    line = np.zeros((*y.shape[:-1], 2))
    for _ in range(3):
        one = np.maximum(weight.sum(axis=-1), 1e-9)
        mx, my = (weight * x).sum(axis=-1) / one, (weight * y).sum(axis=-1) / one
        spread = np.maximum((weight * (x - mx[..., None]) ** 2).sum(axis=-1), 1e-9)
        slope = (weight * (x - mx[..., None]) * (y - my[..., None])).sum(axis=-1) / spread
        line = np.stack([my - slope * mx, slope], axis=-1)
        off = np.abs(y - line[..., :1] - line[..., 1:] * x)
        weight = weight * (off < np.maximum(4.5 * np.median(off, axis=-1, keepdims=True), 0.02))
    return line


def _sampled(grey: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Bilinear values at places (..., 2) px; the image's border continues."""
    u, v = np.clip(at[..., 0], 0, grey.shape[1] - 1.001), np.clip(at[..., 1], 0, grey.shape[0] - 1.001)
    i, j = np.floor(v).astype(int), np.floor(u).astype(int)
    fv, fu = v - i, u - j
    value = grey.astype(float)
    top = value[i, j] * (1 - fu) + value[i, j + 1] * fu
    return top * (1 - fv) + (value[i + 1, j] * (1 - fu) + value[i + 1, j + 1] * fu) * fv
