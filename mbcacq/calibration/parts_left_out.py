"""Parts of a recording, predicted by an arm that was learnt elsewhere and by the other parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.held_out_poses import rms
from mbcacq.calibration.published_cell import LOADS
from mbcacq.calibration.with_effects import some_poses
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import REPORTED_SHARE, EffectModel
from mbcacq.errors import CalibrationError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import one_thread, solve
from mbcacq.estimation.terms import Part, Term
from mbcacq.model.json_text import Number
from mbcacq.model.observations import Observations

PARTS = 5  # of each station, along the order of its poses, as many as the blocks that a calibration is judged by
LEAST_LOAD = 0.02  # of the largest torque about a joint, below which the side of its gear's teeth is not known
LOST_MOTION_RAD = 5e-5  # half of it, of a typical gear: a third of an arc minute, as the catalogue has it; no gear has none
MOST_POSES = 3000  # by which it is fitted and judged: as many as unmodelled effects are learnt from


@dataclass(frozen=True)
class TransferFigures:
    """How far the centres of a recording are from their prediction.

    Attributes
    ----------
    rms_mm : float
        3D rms over the centres.
    median_mm : float
        Median of the 3D distances.
    chi2_dof : float
        Chi square per degree of freedom, under the noise of centres and joints that the learnt cell states. Parameters that were fitted
        to the recording are no degrees of freedom.
    """

    rms_mm: Number
    median_mm: Number
    chi2_dof: Number

    @classmethod
    def of(cls, residual: np.ndarray, whitened: np.ndarray, rank: int = 0) -> TransferFigures:
        """From residuals (m, 3) mm, and the same (m, 3) of unit variance where the prediction is true; rank: of what was fitted to them."""
        distance = np.linalg.norm(residual, axis=1)
        chi2_dof = float(np.sum(whitened**2) / max(whitened.size - rank, 1))
        return cls(rms(distance), float(np.median(distance)), chi2_dof)


@dataclass(frozen=True)
class PartsLeftOut:
    """Parts of the recording, each predicted by the others, arm and effects as learnt.

    Attributes
    ----------
    as_learnt : TransferFigures
        Base, tool and stations are fitted to the other parts.
    drawn_anew : TransferFigures
        Random effects are fitted to the other parts too. They are the effects that differ between recordings, and the unmodelled effects
        beyond the range in which they were learnt.
    """

    as_learnt: TransferFigures
    drawn_anew: TransferFigures


def differing_terms(model: EffectModel, obs: Observations, cell: CalibratedCell) -> tuple[Term, ...]:
    """Effects that differ between recordings, or were not learnt at the postures of a recording, as random effects beside the learnt
    ones; and the lost motion of gears that gravity turns the other way there."""
    learnt = (replace(t, names=tuple(f"other {name}" for name in t.names)) for t in model.left_out_at(obs))
    lost = (
        Term(name, (Part("joint", j, 0, 2.0 * there[:, None]),), (name,), ("rad",), np.array([LOST_MOTION_RAD]))
        for j, there in reversed_joints(obs, cell).items()
        for name in (f"other side of {obs.cell.robot.axes[j]}",)
    )
    return (*learnt, *lost)


def reversed_joints(obs: Observations, cell: CalibratedCell) -> dict[int, np.ndarray]:
    """The joints that gravity turns one way in a recording and hardly ever did where a cell was learnt, with the poses (P,) bool where it
    does so."""
    here, found = Covariates(obs), dict[int, np.ndarray]()
    learnt = np.reshape(cell.extra.get(LOADS, []) if here.masses_known else [], (-1, 2))
    for j, (low, high) in enumerate(learnt):
        torque = here.gravity_torque[:, j]
        least = LEAST_LOAD * max(abs(low), abs(high))
        there = (torque < -least) & (low >= -least) | (torque > least) & (high <= least)
        if there.mean() > REPORTED_SHARE:
            found[j] = there
    return found


def parts_left_out(placed: CalibratedCell, model: EffectModel, cell: CalibratedCell, used: np.ndarray) -> PartsLeftOut | None:
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
    cell : CalibratedCell
        The learnt cell.
    used : np.ndarray
        (M,) bool, the centres that are fitted; every centre is judged.

    Returns
    -------
    PartsLeftOut or None
        Figures of every centre; None if the model leaves out nothing in this recording, or where the
        parts do not determine base, tool and stations.
    """
    keep = some_poses(placed.fit.observations, MOST_POSES)
    used = used[keep[placed.fit.observations.pose]]
    obs = placed.fit.observations.select(keep)
    terms = differing_terms(model, obs, cell)
    if not terms:
        return None
    learnt = tuple((t.at_poses(keep, placed.fit.observations.pose), c) for t, c in placed.fit.options.displaced)
    options = replace(placed.fit.options, displaced=learnt)
    parts = [part[obs.pose] for part in _parts(obs)]
    try:
        with one_thread():
            return PartsLeftOut(*(_left_out(obs, replace(options, terms=t), placed.state, cell.noise, used, parts) for t in ((), terms)))
    except (CalibrationError, np.linalg.LinAlgError):
        return None


def _left_out(
    obs: Observations, options: CalibrationOptions, state: CellState, noise: Noise, used: np.ndarray, parts: Sequence[np.ndarray]
) -> TransferFigures:
    """The figures of all centres, each part (M,) predicted by a fit to those of the others that are used (M,)."""
    lineariser = Lineariser(obs, build(obs, options), options)
    start = Estimate(state, tuple(np.zeros(t.size) for t in options.terms))
    residual, whitened = (np.zeros((obs.n_centres, 3)) for _ in range(2))
    for part in parts:
        at = system(lineariser, start, noise, _weights(obs, used & ~part))
        fitted = solve(at).estimate
        displaced = (*options.displaced, *zip(options.terms, fitted.coefficients, strict=True))
        plain = replace(options, displaced=displaced, terms=())
        there = system(Lineariser(obs, build(obs, plain), plain), Estimate(fitted.state), noise, _weights(obs, part))
        residual[part], whitened[part] = there.residual[part, :3], there.whitened_residual[part, :3]
    return TransferFigures.of(residual, whitened)


def _weights(obs: Observations, centres: np.ndarray) -> Weights:
    return Weights(centres.astype(float), np.ones(obs.n_poses))


def _parts(obs: Observations) -> Sequence[np.ndarray]:
    """(P,) masks of the poses of each part, a stretch of the recording at each of its stations: none is without a station's poses."""
    order = obs.measuring_order
    parts = np.zeros((PARTS, obs.n_poses), bool)
    for station in np.unique(obs.station):
        here = order[obs.station[order] == station]
        for part, poses in zip(parts, np.array_split(here, PARTS), strict=True):
            part[poses] = True
    return [part for part in parts if part.any()]
