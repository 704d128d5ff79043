"""What the pictures of a diagnosis are drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.nonparametric.basis_functions import artefact_tilt
from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
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
    def evidence_map(self) -> dict[tuple[str, str], float]:
        """Evidence for a mismatch by location and covariate, before any effect, most significant first."""
        projected = CandidateScoring.of(self.linear, self.noise)
        return EvidenceMap(projected, DesignBlocks(self.context).groups).evaluate(projected).strengths()


def covariates_at_centres(s: Context) -> dict[str, np.ndarray]:
    """Covariate -> (M,) values of those that vary over the recording."""
    obs, joints = s.obs, range(1, s.n + 1)
    largest = float(np.ptp(s.gravity_torque, axis=0).max())
    # name -> how much it must vary
    least = {f"q{i}": 0.02 for i in joints} | {f"gravity_torque_{i}": 0.02 * largest for i in joints}
    for name, recorded in (("direction_", obs.direction), ("qd", obs.velocity), ("tau", obs.torque)):
        least |= {f"{name}{i}": 0.0 for i in joints} if recorded is not None else {}
    timed = obs.time_s is not None and np.ptp(obs.time_s) > 0
    least |= {"time" if timed else "pose": 0.0} | dict.fromkeys(obs.temperatures, 0.2)
    out = {name: s.value(name) for name in least}
    out = {name: x[obs.pose] for name, x in out.items() if np.ptp(x) > least[name] + 1e-9}
    if s.scanner_on_flange:
        out |= {axis: x for axis, x in zip("xyz", obs.xyz.T, strict=True) if np.ptp(x) > 1e-6}
        tilt = artefact_tilt(s)
        out |= {"tilt": tilt[obs.pose]} if np.ptp(tilt) > 0.02 else {}
    return out


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
    values = covariates_at_centres(context)
    return PlotData(
        points=points[keep],
        before=in_base[0],
        after=in_base[1],
        covariates={name: v[keep] for name, v in values.items()},
        pose=obs.pose_id[obs.pose][keep],
        ball=np.array(obs.cell.ball_ids)[obs.ball[keep]],
        curves=response_curves(linear, values, full.model, full.random_effects, after),
        linear=linear,
        noise=full.geometry_only.noise,
        context=context,
    )
