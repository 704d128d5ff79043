"""A recording continued by poses that are not measured yet, where the cell as it is known today shows the balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.design.simulated_observations import expected_centres
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.model.observations import POSE_COLUMNS, Observations
from mbcacq.plan import PlannedPose

OWN = ("pose_id", "station", "q", "phase", "time_s", "direction", "movement")  # columns that a planned pose has of its own


def continued(obs: Observations, state: CellState, poses: Sequence[PlannedPose], pace_s: float = 0.0) -> Observations:
    """The recording with the planned poses after its own. Quantities that are recorded with a pose and not planned (temperatures, torques)
    are as at the measured pose of the nearest posture.

    state: of the cell, with a place for every station. pace_s: time from one planned pose to the next; 0 takes all for one moment.
    """
    q = np.array([p.q for p in poses]).reshape(-1, obs.cell.robot.n)
    nearest = np.argmin(np.sum((q[:, None] - obs.q[None]) ** 2, axis=2), axis=1)
    first = int(obs.pose_id.max(initial=-1)) + 1
    station, pose, balls = expected_centres(obs.cell, poses)
    after = np.sign(q - obs.q.mean(axis=0)).astype(int)
    own = {
        "pose_id": first + np.arange(len(q)),
        "station": station,
        "q": q,
        "phase": None if obs.phase is None else np.array([p.phase for p in poses]),
        "time_s": None if obs.time_s is None else obs.time_s.max() + pace_s * (1.0 + np.arange(len(q))),
        "direction": None if obs.direction is None else after,
        "movement": None if obs.movement is None else q - obs.q[nearest],
    }
    by_pose = {}
    for name in POSE_COLUMNS:
        values = getattr(obs, name)
        if values is not None:
            by_pose[name] = np.concatenate([values, own[name] if name in OWN else values[nearest]])
    temperatures = {name: np.concatenate([T, T[nearest] if len(T) else T]) for name, T in obs.temperatures.items()}
    rotation = None if obs.rotation is None else np.concatenate([obs.rotation, np.tile(np.eye(3), (len(balls), 1, 1))])
    pose, ball = np.concatenate([obs.pose, obs.n_poses + pose]), np.concatenate([obs.ball, balls])
    xyz = np.concatenate([obs.xyz, np.zeros((len(balls), 3))])
    whole = replace(obs, **by_pose, temperatures=temperatures, pose=pose, ball=ball, xyz=xyz, rotation=rotation)
    whole = replace(whole, n_points=None, rms_mm=None, covariance=None, extra={})
    predicted = forward_model.predict(whole, state).xyz
    return replace(whole, xyz=np.concatenate([obs.xyz, predicted[obs.n_centres :]]))
