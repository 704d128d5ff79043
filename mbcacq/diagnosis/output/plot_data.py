"""What pictures of a diagnosis are drawn from."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.nonparametric import covariates
from mbcacq.diagnosis.nonparametric.evidence_map import map_entries
from mbcacq.diagnosis.output.figures import PlotData
from mbcacq.diagnosis.output.response_curves import curves
from mbcacq.diagnosis.problem import DiagnosisProblem


def evidence_of(setup: DiagnosisProblem, full: ModelFit, before: np.ndarray, after: np.ndarray) -> PlotData:
    """What pictures are drawn from; the map itself is made only when it is drawn."""
    s, linear = setup.context, full.geometry_only.linear
    obs, keep = linear.obs, linear.keep
    if s.scanner_on_flange:
        T = linear.prediction.T_base_scanner[obs.pose]
    else:
        T = linear.prediction.T_base_station[obs.pose]
    points = np.einsum("mij,mj->mi", T[:, :3, :3], obs.xyz) + T[:, :3, 3]
    turned = [np.einsum("mij,mj->mi", T[:, :3, :3], r[:, :3])[keep] for r in (before, after)]
    values = {c.name: np.asarray(c.values, float)[obs.pose] for c in covariates.of_poses(s)}
    if s.scanner_on_flange:
        values |= {c.name: np.asarray(c.values, float) for c in covariates.of_centres(s)}
    named = [obs.pose_id[obs.pose][keep], np.array(obs.cell.ball_ids)[obs.ball[keep]]]
    kept = {name: v[keep] for name, v in values.items()}
    return PlotData(
        lambda: map_entries(full.geometry_only, setup.design_blocks),
        points[keep],
        *turned,
        kept,
        *named,
        lambda: curves(linear, values, full.model, full.smooth, full.conditioned, after),
    )
