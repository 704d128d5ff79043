"""Where a plan asks for accuracy (``accept: box`` or ``places_mm``), and how errors of the geometry act there."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from mbcacq.design.adaptive.options import OPTIONS
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.plan.schema import Acceptance

FEWEST = 3  # places of which lengths between them say all that matters


def accepted_places(accept: Acceptance) -> np.ndarray:
    """(m, 3) mm, base frame: the places that a plan names, the corners and the middle of its box."""
    places: list[Sequence[float]] = list(accept.places_mm)
    if accept.box is not None:
        corners = np.array([accept.box.min_mm, accept.box.max_mm])
        places += [[corners[k, axis] for axis, k in enumerate(which)] for which in product((0, 1), repeat=3)]
        places.append(corners.mean(axis=0).tolist())
    return np.array(places, dtype=float).reshape(-1, 3)


def errors_at(places: np.ndarray, linear: LinearProblem) -> np.ndarray:
    """(r, g): displacements (mm) of points seen at these places (m, 3), by each parameter of the geometry in units of its prior sigma.

    Each place stands for the point seen by the linearised pose that sees one nearest to it, within reach of a view. A motion of all places
    as one rigid body is left out where there are three of them or more: it is where the base is, and no length shows it.
    """
    seen = _seen_points(linear)
    chosen = [int(k) for place in places if (d := np.linalg.norm(seen - place, axis=1)).min() < OPTIONS.near_mm for k in [np.argmin(d)]]
    if not chosen:
        return np.zeros((0, linear.geometry.shape[2]))
    R = linear.prediction.T_base_scanner[linear.obs.pose[chosen], :3, :3]
    moved = np.einsum("mij,mjg->mig", R, linear.geometry[chosen][:, :3] * linear.sigma)
    rows = moved.reshape(-1, moved.shape[2])
    if len(set(chosen)) < FEWEST:
        return rows
    Q = np.linalg.qr(_rigid(seen[chosen]))[0]
    return rows - Q @ (Q.T @ rows)


def _seen_points(linear: LinearProblem) -> np.ndarray:
    """(M, 3) mm, base frame: every ball where the cell puts it."""
    T = linear.prediction.T_base_scanner[linear.obs.pose]
    return np.einsum("mij,mj->mi", T[:, :3, :3], linear.prediction.xyz) + T[:, :3, 3]


def _rigid(points: np.ndarray) -> np.ndarray:
    """(3 m, 6): what three shifts and three small turns displace; turns in units of a metre, about the middle."""
    x, y, z = ((points - points.mean(axis=0)) * 1e-3).T
    o = np.zeros(len(points))
    turns = np.stack([np.stack([o, -z, y], axis=1), np.stack([z, o, -x], axis=1), np.stack([-y, x, o], axis=1)], axis=2)
    return np.concatenate([np.tile(np.eye(3), (len(points), 1)), turns.reshape(-1, 3)], axis=1)
