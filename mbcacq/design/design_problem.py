"""The choice of poses as matrices: the information that each pose brings, and what is to become small by it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.calibration.verification import ball_positions, pairs_of_balls, verification_poses
from mbcacq.design.candidate_views import CandidateView
from mbcacq.design.information_blocks import InformationBlocks
from mbcacq.design.optimality_criteria import AOptimality, Criterion, DOptimality
from mbcacq.design.options import OPTIONS
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.estimation import identifiability, parameters
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.plan import LoadedPlan, PlannedPose


class DesignProblem:
    """Unknowns G: the arm and hand-eye parameters of ``layout``, then six of each station.

    base: (G, G) information of the kept poses and vague knowledge of all; blocks: (P, 6, G) of the candidates; groups: (P,) station (and
    ball) of each.
    """

    def __init__(self, loaded: LoadedPlan, kept: Sequence[PlannedPose], found: Sequence[CandidateView], poses: Sequence[PlannedPose]):
        """kept: calibration poses that stay; found: candidates; poses: of the whole plan, for its verification."""
        self._loaded, self._poses = loaded, poses
        self._state, self._noise = planned_state(loaded), planned_noise(loaded, [*kept, *(c.pose for c in found)])
        everything = planned_observations(loaded, [*kept, *(c.pose for c in found)])
        self.layout = parameters.build(everything, CalibrationOptions(balls=False, refuse=False))
        linear = LinearProblem.of(everything, self._state, layout=self.layout)
        no_effects = np.zeros((*linear.residual.shape, 0))
        blocks = InformationBlocks.of(linear, no_effects, self._noise, linear.keep, rows=6)  # as many as a rigid view can have
        placed = np.tile(OPTIONS.station_sigmas, len(linear.rows.stations))
        every = blocks.Z / np.concatenate([linear.sigma, placed])
        vague = np.concatenate([self.layout.scale, placed])
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


def distance_rows(loaded: LoadedPlan, poses: Sequence[PlannedPose], layout: ParameterLayout) -> np.ndarray:
    """(k, g): change of each certified distance of the verification poses, as measured through the arm, by the parameters."""
    obs = verification_poses(planned_observations(loaded, poses))
    state = planned_state(loaded)
    if obs.n_poses == 0:
        return np.zeros((0, layout.size))
    where, ends = ball_positions(obs, state)
    rows = []
    for station, a, b in pairs_of_balls(where):
        u = where[station, b] - where[station, a]
        each = (ends[station, ball][:2] for ball in (a, b))
        A, B = (identifiability.base_columns(layout, state, q, x[:, None])[0][0] for q, x in each)
        rows.append(u / np.linalg.norm(u) @ (B - A))
    return np.array(rows).reshape(-1, layout.size)
