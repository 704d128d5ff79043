"""Colouring of a scan for display: points on the balls by their distance to the ball, the rest thinned and grey; form of each ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.model.cell import Artefact

RANGE_MM = 0.03  # distance to the sphere at which the colours end
SHELL_MM = 0.5  # a point this near to the certified sphere belongs to the ball
MOST_ON_BALL, MOST_BACKGROUND, MOST_EXAMINED = 150, 300, 400_000
INSIDE, ZERO, OUTSIDE = np.array([33.0, 102, 172]), np.array([240.0, 240, 235]), np.array([214.0, 96, 0])  # blue, white, vermilion
GREY = (96, 102, 112)


@dataclass(frozen=True)
class ColouredScan:
    """on_balls (k, 3) mm with colours (k, 3) uint8; background (b, 3) mm. form_um, radius_um (balls,): range of 95 % of the distances
    to the sphere, and their mean; NaN where a ball has no points."""

    on_balls: np.ndarray
    colours: np.ndarray
    background: np.ndarray
    form_um: np.ndarray
    radius_um: np.ndarray


def colour_scan(points: np.ndarray, artefact: Artefact, ball: np.ndarray, centre: np.ndarray) -> ColouredScan:
    """points (N, 3) mm and the centres (k, 3) mm found of some balls (k,) ids, all in the scanner frame."""
    thinned = points[:: len(points) // MOST_EXAMINED + 1].astype(np.float64)
    columns = np.ascontiguousarray(thinned.T)
    radius = dict(zip(artefact.ball_ids, artefact.diameters / 2, strict=True))
    free = np.ones(len(thinned), bool)
    kept, distances = [], []
    form, size = np.full(len(ball), np.nan), np.full(len(ball), np.nan)
    for k, (number, middle) in enumerate(zip(np.asarray(ball).tolist(), np.asarray(centre), strict=True)):
        r = float(radius[number])
        around = np.flatnonzero(np.abs(columns[0] - middle[0]) < r + SHELL_MM)
        distance = np.sqrt(sum((columns[axis, around] - middle[axis]) ** 2 for axis in range(3))) - r
        on_shell = np.abs(distance) < SHELL_MM
        near, distance = around[on_shell], distance[on_shell]
        free[near] = False
        if len(near) >= 4:
            low, high = _middle_95(distance)
            form[k], size[k] = 1e3 * (high - low), 1e3 * float(np.mean(distance))
        every = len(near) // MOST_ON_BALL + 1
        kept.append(thinned[near[::every]])
        distances.append(distance[::every])
    rest = thinned[free]
    rest = rest[:: len(rest) // MOST_BACKGROUND + 1]
    if not kept:
        return ColouredScan(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), rest, form, size)
    return ColouredScan(np.concatenate(kept), diverging(np.concatenate(distances) / RANGE_MM), rest, form, size)


def _middle_95(values: np.ndarray) -> list[float]:
    """The 2.5 % and the 97.5 % quantile, linear between the values: np.percentile without its overhead."""
    ordered = np.sort(values)
    at = np.array([0.025, 0.975]) * (len(ordered) - 1)
    below = at.astype(int)
    above = np.minimum(below + 1, len(ordered) - 1)
    return (ordered[below] + (at - below) * (ordered[above] - ordered[below])).tolist()


def diverging(share: np.ndarray) -> np.ndarray:
    """(k,) from -1 to 1 -> (k, 3) uint8: blue, white, vermilion, which the colour-blind can distinguish too."""
    share = np.clip(np.nan_to_num(share), -1.0, 1.0)[:, None]
    away = np.where(share < 0, INSIDE, OUTSIDE)
    return np.rint(ZERO + np.abs(share) * (away - ZERO)).astype(np.uint8)
