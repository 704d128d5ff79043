"""The share of one recording in a fit of several: the arm and its effects are of all, the cell around it is its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.calibration.observation_fit import ObservationFit
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import HAND_EYE, ParameterLayout, build
from mbcacq.estimation.pose_information import Weights
from mbcacq.model.observations import Observations


def share_of(
    together: ObservationFit, whole: CellEstimate, parts: Sequence[Adjustment], r: int, options: CalibrationOptions
) -> tuple[ObservationFit, CellEstimate]:
    """The fit and the cell of recording ``r``. together, whole: those of all; parts: each recording by itself, as it was fitted alone."""
    every, obs = together.observations, parts[r].lineariser.obs
    poses = np.flatnonzero(every.recording == r)
    centres = np.isin(every.pose, poses)
    stations = slice(*_range([len(p.lineariser.obs.cell.stations) for p in parts], r))
    balls = slice(*_range([len(p.lineariser.obs.cell.ball_ids) for p in parts], r))
    cell = whole.state
    state = CellState(cell.chain, cell.T_flange_scanner[r], cell.T_base_station[stations], cell.balls[balls])
    kept = () if whole.effects is None else tuple(t.names for t in whole.effects.terms)
    layout, index, coefficients = _own_layout(together, whole.layout, build(obs, replace(options, hold=())), r, balls, kept)
    weights = Weights(together.weights.centre[centres], together.weights.pose[poses])
    used = (weights.centre > 0) & (weights.pose[obs.pose] > 0)
    rank = layout.size - int(layout.blocks[0].free.sum()) - sum(len(names) for names in kept)
    rank += int(np.sum(np.linalg.matrix_rank(together.station_covariance[stations])))
    whitened = together.whitened[centres]
    dof, places = max(int(used.sum()) * whitened.shape[1] - rank, 0), together.station_covariance[stations]
    own = replace(together, observations=obs, options=options, coefficients=coefficients, station_covariance=places, weights=weights)
    fit = replace(own, residual=together.residual[centres], whitened=whitened, chi2=float(np.sum(whitened**2)), dof=dof, rank=rank)
    fit = replace(fit, rejected=(), correlated=())
    noise, covariance = _own_noise(whole.noise, every, int(poses[0])), whole.covariance[np.ix_(index, index)]
    return fit, CellEstimate(state=state, layout=layout, covariance=covariance, noise=noise, effects=whole.effects)


def _own_noise(noise: Noise, together: Observations, pose: int) -> Noise:
    if together.noise_scale is None:
        return noise
    ratio = together.noise_scale[pose]
    return Noise(noise.point * ratio[:3], noise.joint * ratio[3:], noise.turn)


def _own_layout(
    together: ObservationFit, whole: ParameterLayout, own: ParameterLayout, r: int, balls: slice, kept: Sequence[tuple[str, ...]]
) -> tuple[ParameterLayout, np.ndarray, tuple[np.ndarray, ...]]:
    """The parameters of recording ``r`` as they were free with all, their (g,) indices there, and the coefficients of the effects kept."""
    blocks = whole.blocks
    position = np.cumsum(np.concatenate([b.free for b in blocks])) - 1
    start = np.cumsum([0] + [len(b.names) for b in blocks])
    ends = (start[0], start[1]), (start[1] + 6 * r, start[1] + 6 * r + 6), (start[2] + 3 * balls.start, start[2] + 3 * balls.stop)
    mine = [np.arange(*ends_of_one) for ends_of_one in ends]
    arm, mount, ball = own.blocks[:3]
    free = np.concatenate([b.free for b in blocks])
    prefix = f"hand_eye[{r + 1}]."
    why = {name.replace(prefix, "hand_eye."): text for name, text in blocks[1].why.items() if name.startswith(prefix)}
    mount = replace(mount, free=free[mine[1]], why=why | (mount.why if len(HAND_EYE) * 2 > len(blocks[1].names) else {}))
    out = [blocks[0], mount, replace(ball, free=free[mine[2]])]
    coefficients = []
    for n, b in enumerate(blocks[3:], 3):
        if b.names in kept:
            out.append(b)
            mine.append(np.arange(start[n], start[n + 1]))
            coefficients.append(together.coefficients[n - 3])
    assert arm.names == blocks[0].names, "the recordings are of one arm"
    chosen = np.concatenate(mine)
    return ParameterLayout(tuple(out)), position[chosen[free[chosen]]], tuple(coefficients)


def _range(counts: Sequence[int], r: int) -> tuple[int, int]:
    end = np.cumsum(counts)
    return int(end[r] - counts[r]), int(end[r])
