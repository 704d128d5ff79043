"""The choice of poses as matrices: the information that each pose brings, and what is to become small by it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.calibration.verification import ball_positions, verification_poses
from mbcacq.design.candidate_views import CandidateView
from mbcacq.design.optimality_criteria import AOptimality, Criterion, DOptimality
from mbcacq.design.options import OPTIONS
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.estimation import identifiability, parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.estimation.whitening import Whitening
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose


class DesignProblem:
    """Unknowns G: the arm and hand-eye parameters of ``layout``, then six of each station.

    base: (G, G) information of the kept poses and vague knowledge of all; blocks: (P, 6, G) of the candidates; groups: (P,) station (and
    ball) of each.
    """

    def __init__(
        self, loaded: LoadedPlan, kept: Sequence[PlannedPose], found: Sequence[CandidateView], poses: Sequence[PlannedPose]
    ) -> None:
        """kept: calibration poses that stay; found: candidates; poses: of the whole plan, for its verification."""
        self._loaded, self._poses = loaded, poses
        self._state, self._noise = planned_state(loaded), planned_noise(loaded, [*kept, *(c.pose for c in found)])
        everything = planned_observations(loaded, [*kept, *(c.pose for c in found)])
        self.layout = parameters.build(everything, CalibrationOptions(balls=False, refuse=False))
        used, place = np.unique(everything.station, return_inverse=True)
        rows = pose_information(everything, self._state, self.layout, self._noise)
        g = self.layout.size
        every = np.zeros((len(rows), rows.shape[1], g + 6 * len(used)))
        every[:, :, :g] = rows[:, :, :g]
        columns = g + 6 * place[:, None] + np.arange(6)
        every[np.arange(len(rows))[:, None, None], np.arange(rows.shape[1])[None, :, None], columns[:, None, :]] = rows[:, :, g:]
        vague = np.concatenate([self.layout.scale, np.tile(OPTIONS.station_sigmas, len(used))])
        known = every[: len(kept)].reshape(-1, every.shape[2])
        self.base = np.diag(1 / vague**2) + known.T @ known
        self.blocks = every[len(kept) :]
        self.groups = np.unique([f"{c.station} {c.aim}" for c in found], return_inverse=True)[1]

    def criterion(self, name: str) -> Criterion:
        """'A' or 'D', see ``optimal_design.design``."""
        if name == "D":
            return DOptimality(self.layout.size)
        target = np.zeros_like(self.base)
        g = self.layout.size
        rows = distance_rows(self._loaded, self._poses, self.layout)
        if len(rows):
            target[:g, :g] = rows.T @ rows / len(rows)
        else:
            observations = planned_observations(self._loaded, self._poses)
            target[:g, :g] = identifiability.workspace_information(observations, self._state, self.layout)
        return AOptimality(target)


def pose_information(obs: Observations, state: CellState, layout: ParameterLayout, noise: Noise) -> np.ndarray:
    """(P, 6, g + 6): whitened rows of each pose, in the order of ``obs``, by arm and hand-eye and by its own station, brought down to the
    six that a rigid view can have."""
    lineariser = Lineariser(obs, layout, CalibrationOptions(balls=False, refuse=False))
    columns = lineariser.at(lineariser.evaluate(parameters.Estimate(state)))
    weights = np.ones(obs.n_centres), np.ones(obs.n_poses)
    X = Whitening(lineariser.rows, columns.of_joints, noise, *weights)(columns.dense)[..., :-1]
    value, vector = np.linalg.eigh(np.swapaxes(X, 1, 2) @ X)
    value, vector = value[:, -6:], vector[:, :, -6:]
    reduced = np.sqrt(np.maximum(value, 0.0))[:, :, None] * np.swapaxes(vector, 1, 2)
    out = np.empty_like(reduced)
    out[lineariser.rows.order] = reduced
    return out


def distance_rows(loaded: LoadedPlan, poses: Sequence[PlannedPose], layout: ParameterLayout) -> np.ndarray:
    """(k, g): change of each certified distance of the verification poses, as measured through the arm, by the parameters."""
    obs = verification_poses(planned_observations(loaded, poses))
    state = planned_state(loaded)
    if obs.n_poses == 0:
        return np.zeros((0, layout.size))
    where, ends = ball_positions(obs, state)
    keys, rows = sorted(where), []
    for i, (station, a) in enumerate(keys):
        for other, b in keys[i + 1 :]:
            if other == station:
                u = where[other, b] - where[station, a]
                qa, xa, _ = ends[station, a]
                qb, xb, _ = ends[other, b]
                A, B = (identifiability.base_columns(layout, state, q, x[:, None])[0][0] for q, x in ((qa, xa), (qb, xb)))
                rows.append(u / np.linalg.norm(u) @ (B - A))
    return np.array(rows).reshape(-1, layout.size)
