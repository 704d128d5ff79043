"""Calibration of one arm from several recordings: the arm and its effects are shared, every recording keeps its own cell around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibration_fit import positive_inverse
from mbcacq.calibration.result import Calibration
from mbcacq.errors import CalibrationError
from mbcacq.estimation import parameters
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.several_recordings import JointAdjustment, adjust_together
from mbcacq.estimation.solver import Weights
from mbcacq.model.observations import Observations


def calibrate_together(recordings: Sequence[Observations], options: CalibrationOptions | None = None) -> tuple[Calibration, ...]:
    """One calibration for each recording: all have the same arm and effects, with the covariance that all recordings together give them.

    Base, tool, stations, artefacts and noise are each recording's own. Raises ConfigError where the recordings are not of one arm,
    CalibrationError where one contradicts its cell.
    """
    options = options or CalibrationOptions()
    try:
        joint = adjust_together(recordings, options)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recordings contradict each other so much that no arm fits them ({error})") from error
    return tuple(_calibration_of(joint, r, options) for r in range(len(joint.parts)))


def _calibration_of(joint: JointAdjustment, r: int, options: CalibrationOptions) -> Calibration:
    """The share of one recording in a joint adjustment."""
    whole, part, together = joint.adjusted, joint.parts[r], joint.observations
    obs = part.lineariser.obs
    poses = np.flatnonzero(together.recording == r)
    centres = np.isin(together.pose, poses)
    stations = slice(*_range([len(p.lineariser.obs.cell.stations) for p in joint.parts], r))
    balls = slice(*_range([len(p.lineariser.obs.cell.ball_ids) for p in joint.parts], r))
    state = replace(
        whole.state,
        T_flange_scanner=whole.state.T_flange_scanner[r],
        T_base_station=whole.state.T_base_station[stations],
        balls=whole.state.balls[balls],
    )
    layout = parameters.build(obs, options)
    for name, why in whole.lineariser.layout.held.items():
        if name in layout.blocks[0].names and name not in layout.held:
            layout = layout.hold(name, why)
    index = _own_columns(whole, layout, r, balls)
    normal, solution = whole.solution.normal, whole.solution
    scale = whole.lineariser.layout.gather("scale")
    covariance = scale[:, None] * positive_inverse(scale[:, None] * normal.information * scale) * scale
    station_covariance = np.zeros((len(together.cell.stations), 6, 6))
    station_covariance[whole.lineariser.rows.stations] = normal.station_covariance(covariance)
    ratio = np.ones(3 + obs.cell.robot.n) if together.noise_scale is None else together.noise_scale[poses[0]]
    residual = solution.linear.residual[centres]
    whitened = whole.lineariser.rows.unpad(solution.X[..., -1:])[..., 0][centres]
    weights = Weights(whole.weights.centre[centres], whole.weights.pose[poses])
    used = (weights.centre > 0) & (weights.pose[obs.pose] > 0)
    own = layout.size - int(layout.blocks[0].free.sum()) - sum(t.size for t in options.terms)
    rank = own + int(np.sum(np.linalg.matrix_rank(station_covariance[stations]))) if len(used) else own
    return Calibration(
        obs,
        options,
        layout,
        state,
        part.preliminary,
        solution.estimate.coefficients,
        covariance[np.ix_(index, index)],
        station_covariance[stations],
        Noise(whole.noise.point * ratio[:3], whole.noise.joint * ratio[3:], whole.noise.turn),
        weights,
        residual,
        whitened,
        float(np.sum(whitened**2)),
        max(int(used.sum()) * residual.shape[1] - rank, 0),
        rank,
        solution.iterations,
        tuple(whole.found),
    )


def _own_columns(whole: Adjustment, layout: parameters.ParameterLayout, r: int, balls: slice) -> np.ndarray:
    """(g,) indices into the joint parameters of those of recording ``r``, in the order of its own layout."""
    blocks = whole.lineariser.layout.blocks
    position = np.cumsum(np.concatenate([b.free for b in blocks])) - 1
    start = np.cumsum([0] + [len(b.names) for b in blocks])
    full = [
        np.arange(start[0], start[1]),
        np.arange(start[1] + 6 * r, start[1] + 6 * r + 6),
        np.arange(start[2] + 3 * balls.start, start[2] + 3 * balls.stop),
        *(np.arange(a, b) for a, b in zip(start[3:-1], start[4:], strict=True)),
    ]
    free = [f[b.free] for f, b in zip(full, layout.blocks, strict=True)]
    return position[np.concatenate(free)]


def _range(counts: Sequence[int], r: int) -> tuple[int, int]:
    end = np.cumsum(counts)
    return int(end[r] - counts[r]), int(end[r])
