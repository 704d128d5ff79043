"""Normals of the artefacts (their z axes) as a scanner on the flange sees them, from the measured centres and the nominal arm."""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3
from mbcacq.model.observations import Observations

LEAST_WIDTH = 5.0  # mm, second singular value of centres that are not on one line


def artefact_normals(obs: Observations, R_base_flange: np.ndarray) -> np.ndarray:
    """(P, 3) unit vectors in the scanner's axes.

    R_base_flange: (P, 3, 3) of the nominal arm. A pose that sees three balls not on one line shows the normal by itself. For others it is
    the mean normal of the station in the base; at a station without such poses, which holds a bar or a single ball, the mean direction
    towards the scanner.
    """
    R_base_scanner = R_base_flange @ obs.cell.T_flange_scanner.reshape(-1, 4, 4)[0, :3, :3]
    towards = R_base_scanner[:, :, 2] * _side(obs)
    own = np.array([_measured_normal(obs, p) for p in range(obs.n_poses)])
    seen = np.isfinite(own[:, 0])
    in_base = np.where(seen[:, None], np.einsum("pij,pj->pi", R_base_scanner, np.nan_to_num(own)), towards)
    out = own.copy()
    for station in np.unique(obs.station):
        here = obs.station == station
        known = here & seen if np.any(here & seen) else here
        normal = in_base[known].mean(axis=0)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
        missing = here & ~seen
        out[missing] = np.einsum("pji,j->pi", R_base_scanner[missing], normal)
    return out


def _side(obs: Observations) -> float:
    """1 where the scanner's z points back at the scanner, -1 where it points at the artefacts: from the first guess of where it sits."""
    T = obs.cell.T_flange_scanner.reshape(-1, 4, 4)[0]
    return 1.0 if T[:3, 3] @ T[:3, 2] < 0 else -1.0


def _measured_normal(obs: Observations, pose: int) -> np.ndarray:
    """(3,) of one pose; NaN where its centres do not determine it."""
    rows = np.flatnonzero(obs.pose == pose)
    if len(rows) < 3:
        return np.full(3, np.nan)
    certified = obs.cell.ball_centres[obs.ball[rows]]
    if np.linalg.svd(certified - certified.mean(axis=0), compute_uv=False)[1] < LEAST_WIDTH:
        return np.full(3, np.nan)
    measured = obs.xyz[rows]
    return se3.nearest_rotation((measured - measured.mean(axis=0)).T @ (certified - certified.mean(axis=0)))[:, 2]
