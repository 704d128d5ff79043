"""A check on a part instead of an artefact: how its scans stand to each other says whether the cell is as it was.

The scene of a part is looked at as an artefact of three points that move with it. Its frame is made anew every day, and so its place is
not judged. The noise of these points is that of the first day's scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import qr

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.interim_check.planned_check import PlannedCheck
from mbcacq.interim_check.possible_changes import jitter
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose

POINTS = (1_000_001, 1_000_002, 1_000_003)  # numbers that no certificate has
LEVER_MM = 50.0


def with_points(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> tuple[LoadedPlan, list[PlannedPose]]:
    """The plan with three points in the place of its part, and the poses that scan this. Raises ConfigError if it scans none, or parts
    at several stations."""
    parts = {a.id for a in loaded.cell.artefacts if a.is_part}
    scans = [replace(p, balls=POINTS) for p in poses if p.artefact in parts]
    if len({p.station for p in scans}) != 1:
        what = "scans parts at several stations" if scans else "scans no part"
        raise ConfigError(f"{loaded.path} {what}; a check on a part needs a plan that scans one part at one station")
    part = loaded.cell.artefact(scans[0].artefact)
    box = part.box if part.mesh is None else np.stack([part.mesh.vertices.min(axis=0), part.mesh.vertices.max(axis=0)])
    middle = np.zeros(3) if box is None else box.mean(axis=0)
    centres = middle + np.array([[0.0, 0.0, 0.0], [LEVER_MM, 0.0, 0.0], [0.0, LEVER_MM, 0.0]])
    seen = replace(part, ball_ids=POINTS, centres=centres, diameters=np.zeros(3))
    artefacts = tuple(seen if a is part else a for a in loaded.cell.artefacts if a is part or not a.is_part)
    stations = tuple(s for s in loaded.cell.stations if s.artefact in {a.id for a in artefacts})
    return replace(loaded, cell=replace(loaded.cell, artefacts=artefacts, stations=stations)), scans


def seen_as_points(check: PlannedCheck, obs: Observations) -> tuple[Observations, np.ndarray]:
    """Scenes that were measured as the points of a check, and the covariance (9 P, 9 P) mm^2 of these in the order of the poses.

    Raises ConfigError where none of the check's poses is among them.
    """
    obs = obs.select(np.isin(obs.pose_id, check.obs.pose_id)).measured()
    if obs.rotation is None or not obs.n_poses:
        raise ConfigError("none of the poses of the check was scanned in that recording; give one of this check")
    cell, T = check.obs.cell, se3.transform(obs.rotation, obs.xyz)
    station = next(k for k, s in enumerate(cell.stations) if s.id == obs.cell.stations[0].id)
    T_base_scene = check.cell.frames(obs.q[:1])[0, -1] @ check.state.T_flange_scanner @ T[0]
    balls = np.flatnonzero(np.isin(cell.ball_ids, POINTS))
    centres = se3.apply(check.state.T_base_station[station], cell.ball_centres[balls])
    xyz = se3.apply(T[:, None], se3.apply(se3.inverse(T_base_scene), centres)[None])  # (P, 3, 3)
    count, own = len(T), obs.covariance
    shared = np.zeros((count, 6, 0)) if obs.shared is None else obs.shared
    total = np.einsum("pik,qjk->piqj", shared, shared)
    total[np.arange(count), :, np.arange(count)] += np.zeros((count, 6, 6)) if own is None else own
    arms = xyz - T[:, None, :3, 3]
    J = np.concatenate([np.broadcast_to(np.eye(3), (*arms.shape, 3)), -se3.skew(arms)], axis=3).reshape(count, 9, 6)
    noise = np.einsum("pai,piqj,qbj->paqb", J, total, J).reshape(9 * count, 9 * count)
    pose, ball = np.repeat(np.arange(count), 3), np.tile(balls, count)
    points = replace(obs, cell=cell, station=np.full(count, station), pose=pose, ball=ball, xyz=xyz.reshape(-1, 3))
    return replace(points, rotation=None, covariance=None, shared=None), noise


def with_noise(check: PlannedCheck, noise: np.ndarray) -> PlannedCheck:
    """The check with the noise (R, R) of its points. Six of the nine coordinates of a pose count, those that are least alike:
    three points of a rigid scene have no more."""
    obs, xyz = check.obs, check.prediction.xyz.reshape(-1, 3, 3)
    shown = np.zeros((len(xyz), 9), dtype=bool)
    for k, points in enumerate(xyz):
        arms = (points - points.mean(axis=0)) / LEVER_MM
        J = np.concatenate([np.broadcast_to(np.eye(3), (3, 3, 3)), -se3.skew(arms)], axis=2).reshape(9, 6)
        shown[k, np.asarray(qr(J.T, pivoting=True, mode="r")[-1])[:6]] = True
    moved = jitter(obs, check.state, check.prediction, np.zeros(3), check.cell.noise.joint)
    return replace(check, rows=replace(check.rows, noise=moved + noise), shown=shown.reshape(-1))
