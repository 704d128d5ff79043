"""What the pictures of a diagnosis are drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric import covariates
from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_map import MapEntry, map_entries
from mbcacq.diagnosis.output.response_curves import ResponseCurve, response_curves
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.effects.context import Context
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise


@dataclass(frozen=True)
class PlotData:
    """Residuals of the kept centres and what they depend on; it pickles.

    points: (M, 3) mm measured centres in the base frame. before, after: (M, 3) mm residuals in base axes, of the geometry alone and of
    the model with its effects. covariates: name -> (M,) values. pose, ball: (M,) numbers of the recording. curves: response of each
    effect. linear, noise, context: the fitted problem, from which the evidence map is computed when it is first asked for.
    """

    points: np.ndarray
    before: np.ndarray
    after: np.ndarray
    covariates: dict[str, np.ndarray]
    pose: np.ndarray
    ball: np.ndarray
    curves: list[ResponseCurve]
    linear: LinearProblem
    noise: Noise
    context: Context

    @cached_property
    def evidence_map(self) -> list[MapEntry]:
        """Evidence for a mismatch by location and covariate, before any effect, most significant first."""
        return map_entries(CandidateScoring.of(self.linear, self.noise), DesignBlocks(self.context))


def plot_data(setup: DiagnosisProblem, full: ModelFit, before: np.ndarray, after: np.ndarray) -> PlotData:
    """The plot data of a fit; before, after: (M, R) mm residuals in the frame of the instrument."""
    context, linear = setup.context, full.geometry_only.linear
    obs, keep = linear.obs, linear.keep
    if context.scanner_on_flange:
        T = linear.prediction.T_base_scanner[obs.pose]
    else:
        T = linear.prediction.T_base_station[obs.pose]
    points = np.einsum("mij,mj->mi", T[:, :3, :3], obs.xyz) + T[:, :3, 3]
    in_base = [np.einsum("mij,mj->mi", T[:, :3, :3], r[:, :3])[keep] for r in (before, after)]
    values = {c.name: np.asarray(c.values, float)[obs.pose] for c in covariates.of_poses(context)}
    if context.scanner_on_flange:
        values |= {c.name: np.asarray(c.values, float) for c in covariates.of_centres(context)}
    return PlotData(
        points=points[keep],
        before=in_base[0],
        after=in_base[1],
        covariates={name: v[keep] for name, v in values.items()},
        pose=obs.pose_id[obs.pose][keep],
        ball=np.array(obs.cell.ball_ids)[obs.ball[keep]],
        curves=response_curves(linear, values, full.model, full.smooth, full.conditioned, after),
        linear=linear,
        noise=full.geometry_only.noise,
        context=context,
    )
