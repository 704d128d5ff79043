"""Parts of a recording, predicted by an arm that was learnt elsewhere and by the other parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.with_effects import some_poses
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import CalibrationError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import one_thread, solve
from mbcacq.estimation.terms import Term
from mbcacq.model.observations import Observations

PARTS = 5  # of each station, along the order of its poses, as many as the blocks that a calibration is judged by
MOST_POSES = 3000  # by which it is fitted and judged: as many as unmodelled effects are learnt from


@dataclass(frozen=True)
class CentreResiduals:
    """Centres less what is predicted for them. residual: (m, 3) mm; whitened: (m, 3), of unit variance under the noise that was learnt
    where the prediction is true."""

    residual: np.ndarray
    whitened: np.ndarray


def differing_terms(model: EffectModel, obs: Observations) -> tuple[Term, ...]:
    """Effects that differ between recordings, or were not learnt at the postures of a recording, as random effects beside the learnt
    ones."""
    return tuple(replace(t, names=tuple(f"other {name}" for name in t.names)) for t in model.left_out_at(obs))


def parts_left_out(
    placed: CalibratedCell, model: EffectModel, noise: Noise, used: np.ndarray
) -> tuple[CentreResiduals, CentreResiduals] | None:
    """Predictions of parts of a recording by its other parts: without and with what the recording learnt from could not teach.

    Arm and effects stay as they were learnt. Base, tool and stations are fitted to four of five parts. The second time, random effects are
    fitted with them at the sizes that were learnt. They are the effects that differ between recordings (drift, traces of movements), and
    unmodelled effects beyond the range in which they were learnt. The fifth part is predicted. The second prediction leaves wrongly learnt
    effects, and noise.

    Parameters
    ----------
    placed : CalibratedCell
        The arm with its effects on the recording, whose base, tool and stations are fitted.
    model : EffectModel
        The effects that were learnt.
    noise : Noise
        That was learnt.
    used : np.ndarray
        (M,) bool, the centres that are fitted; every centre is judged.

    Returns
    -------
    tuple of CentreResiduals, or None
        As learnt, and drawn anew, of every centre; None where the model leaves out nothing in this recording, or where the
        parts do not determine base, tool and stations.
    """
    keep = some_poses(placed.fit.observations, MOST_POSES)
    used = used[keep[placed.fit.observations.pose]]
    obs = placed.fit.observations.select(keep)
    terms = differing_terms(model, obs)
    if not terms:
        return None
    learnt = tuple((t.at_poses(keep, placed.fit.observations.pose), c) for t, c in placed.fit.options.displaced)
    options = replace(placed.fit.options, displaced=learnt)
    parts = [part[obs.pose] for part in _parts(obs)]
    try:
        with one_thread():
            as_learnt, drawn_anew = (_left_out(obs, replace(options, terms=t), placed.state, noise, used, parts) for t in ((), terms))
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    return as_learnt, drawn_anew


def _left_out(
    obs: Observations, options: CalibrationOptions, state: CellState, noise: Noise, used: np.ndarray, parts: Sequence[np.ndarray]
) -> CentreResiduals:
    """Residuals at all centres, each part (M,) predicted by a fit to those of the others that are used (M,)."""
    lineariser = Lineariser(obs, build(obs, options), options)
    start = Estimate(state, tuple(np.zeros(t.size) for t in options.terms))
    residual, whitened = (np.zeros((obs.n_centres, 3)) for _ in range(2))
    for part in parts:
        at = system(lineariser, start, noise, _weights(obs, used & ~part))
        fitted = solve(at).estimate
        predicted = _predicted(obs, options, fitted, noise, _weights(obs, part))
        residual[part], whitened[part] = predicted.residual[part], predicted.whitened[part]
    return CentreResiduals(residual, whitened)


def _predicted(obs: Observations, options: CalibrationOptions, fitted: Estimate, noise: Noise, weights: Weights) -> CentreResiduals:
    """The residuals of all centres by a fitted cell."""
    displaced = (*options.displaced, *zip(options.terms, fitted.coefficients, strict=True))
    plain = replace(options, displaced=displaced, terms=())
    at = system(Lineariser(obs, build(obs, plain), plain), Estimate(fitted.state), noise, weights)
    return CentreResiduals(at.residual[:, :3], at.whitened_residual[:, :3])


def _weights(obs: Observations, centres: np.ndarray) -> Weights:
    return Weights(centres.astype(float), np.ones(obs.n_poses))


def _parts(obs: Observations) -> Sequence[np.ndarray]:
    """(P,) masks of the poses of each part, a stretch of the recording at each of its stations: none is without a station's poses."""
    order = np.arange(obs.n_poses) if obs.time_s is None else np.argsort(obs.time_s, kind="stable")
    parts = np.zeros((PARTS, obs.n_poses), bool)
    for station in np.unique(obs.station):
        here = order[obs.station[order] == station]
        for part, poses in zip(parts, np.array_split(here, PARTS), strict=True):
            part[poses] = True
    return [part for part in parts if part.any()]
