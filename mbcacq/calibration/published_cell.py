"""What is published of an adjusted cell: its notes, the nominal arm, a scale from one known length, effects with their estimates.

Two kinds of cells have a larger covariance than their adjustment. The nominal arm has uncertain link errors that are not applied: a
hand-eye calibration is used with the nominal arm, so every uncertainty is the second moment of the error about it. A scale from one known
length is as uncertain as the length and as its mean over the scans. The hand-eye transform follows it; by how much is seen from a second
adjustment with all lengths a little larger.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell, adjusted_cell
from mbcacq.calibration.change import NOTABLE, ChangeEvidence
from mbcacq.calibration.change_found import ChangeFound
from mbcacq.calibration.target_size import target_scale, wrong_length
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.adjustment import Adjustment, adjust_recording, as_it_is
from mbcacq.estimation.options import copies
from mbcacq.estimation.parameters import HAND_EYE, Estimate
from mbcacq.estimation.scan_scale import known_length_sigma
from mbcacq.estimation.solver import solve
from mbcacq.estimation.terms import LENGTH, LENGTH_NAMES, SHARED
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, SCENE
from mbcacq.model.joint_resolution import rounding_sentence
from mbcacq.model.observations import Observations

LOADS = "loads_Nm"
LEAST_STEP = 1e-5  # of a scale, relative; below, rounding would show
TWIST = tuple(f"hand_eye.{c}" for c in HAND_EYE)


def cell_of(adjustment: Adjustment) -> CalibratedCell:
    """The calibrated cell of an adjustment, which it holds.

    'stated_chi2_dof' of ``extra`` is chi square per degree of freedom under the noise that scanner and data sheet state, where both state
    one: the noise that a calibration estimates makes its own chi square 1, whatever is wrong.
    """
    found, cell = adjusted_cell(adjustment.lineariser.options, adjustment), adjustment.lineariser.obs.cell
    stated = cell.noise_mm is not None and cell.robot.repeatability_mm and found.fit.dof > 0
    extra = {"stated_chi2_dof": adjustment.stated_chi2 / found.fit.dof} if stated else {}
    return replace(found, own_adjustment=adjustment, extra={**found.extra, **extra})


def warned(cell: CalibratedCell, sentence: str, first: bool = False, **further: Any) -> CalibratedCell:
    """The cell with one more warning, and further values of ``extra``."""
    before = cell.extra.get("warnings", ())
    return replace(cell, extra={**cell.extra, **further, "warnings": [sentence, *before] if first else [*before, sentence]})


def averaged_over_changes(cell: CalibratedCell, change: ChangeEvidence) -> CalibratedCell:
    """The cell with a covariance that counts changes while it was recorded, found or not, each by its probability.

    The second moment of the error about what is published, C + p M with M that of the error where something changed (Bayesian model
    averaging). 'change_probability' of ``extra`` is p, where it is worth saying.
    """
    if change.second_moment is None:
        return cell
    said = {"change_probability": change.probability} if change.probability > NOTABLE else {}
    covariance = cell.covariance + change.probability * change.second_moment
    return replace(cell, covariance=covariance, extra={**cell.extra, **said})


def with_accident(cell: CalibratedCell, accident: ChangeFound | str | None) -> CalibratedCell:
    """The cell with a warning of what happened while it was recorded; as it is where nothing did."""
    if not accident:
        return cell
    sentence, further = (accident, {}) if isinstance(accident, str) else (accident.sentence, {"change": accident.to_dict()})
    return warned(cell, f"Something changed while the recording was made: {sentence}", first=True, **further)


def with_notes_on_poses(cell: CalibratedCell, observations: Observations) -> CalibratedCell:
    """The cell with warnings of poses that are copies of others, and of joint angles that were rounded."""
    twice = observations.pose_id[copies(observations)]
    if len(twice):
        some = ", ".join(map(str, twice[:5])) + (", .." if len(twice) > 5 else "")
        said = f"{len(twice)} poses are exact copies of earlier ones ({some}) and are counted once; measure again instead of copying"
        cell = warned(cell, said)
    length = wrong_length(cell.fit.observations)
    if length and not any(length in said for said in cell.extra.get("warnings", ())):
        cell = warned(cell, f"A length contradicts the poses of the flange: {length}")
    if scale := target_scale(cell.fit.observations):
        cell = replace(cell, extra={**cell.extra, "scale_from": str(scale)})
    if observations.images is not None:
        at = [i for i, name in enumerate(cell.names) if name.startswith(f"{SHARED}_")]
        found = next((c for t, c in cell.fit.instrument_errors(observations) if t.name == SHARED), np.zeros(0))
        said = observations.images.calibrated(found, cell.covariance[np.ix_(at, at)])
        cell = replace(cell, extra={**cell.extra, "images": said})
    if LENGTH_NAMES[0] in cell.names:
        at = [cell.names.index(name) for name in LENGTH_NAMES]
        offset, scale = next(c for t, c in cell.fit.instrument_errors(observations) if t.name == LENGTH)
        std = np.sqrt(np.diag(cell.covariance)[at])
        said = {"offset_mm": float(offset), "offset_std_mm": float(std[0]), "scale": float(scale), "scale_std": float(std[1])}
        cell = replace(cell, extra={**cell.extra, "length_instrument": said})
    if any(artefact.id == SCENE for artefact in observations.cell.artefacts):
        said = "that of the scanner, since a part has no length that is known; an artefact with a certificate would show it"
        cell = replace(cell, extra={**cell.extra, "scale_from": said})
        if len(alone := observations.pose_id[np.bincount(observations.pose, minlength=observations.n_poses) == 0]):
            some = ", ".join(map(str, alone.tolist()))
            cell = warned(cell, f"{len(alone)} scans overlap too little with the others and take no part (poses {some})")
    step = cell.fit.observations.cell.joint_step
    return warned(cell, rounding_sentence(step)) if step else cell


def with_loads(cell: CalibratedCell) -> CalibratedCell:
    """The cell with the range of the torques of gravity that each joint carried in nine of ten poses: 'loads_Nm' of result.json, where
    masses are known."""
    here = Covariates(cell.fit.observations)
    if not here.masses_known or here.obs.cell.robot.of_flange_poses:
        return cell
    return replace(cell, extra={**cell.extra, LOADS: np.quantile(here.gravity_torque, (0.05, 0.95), axis=0).T.tolist()})


def with_nominal_arm(result: CalibratedCell) -> CalibratedCell:
    """The result with the nominal arm in place of its most probable one.

    The covariance C of the parameters' errors about their estimate becomes C + u u' with u the estimated link errors that are left out: the
    second moment about what is published. Residuals are those of the nominal arm; chi square stays that of the model with link errors,
    which is the one that says whether the data contradict the noise.

    Parameters
    ----------
    result : CalibratedCell
        With link errors as random effects (``CalibrationOptions(kinematics=False)``), and with its adjustment.
    """
    chain = result.layout.blocks[0]
    if not chain.free.any():
        return result
    lineariser, state = result.adjustment.lineariser, replace(result.state, chain=result.nominal)
    left_out = np.zeros(result.layout.size)
    left_out[: int(chain.free.sum())] = result.errors.reshape(-1)[chain.free]
    if lineariser.obs.cell.measurement == ARTEFACT_IN_SCANNER:  # artefacts stand where the nominal arm sees them; an instrument is a result
        fitted = zip(lineariser.options.terms, result.fit.coefficients, strict=True)
        known = (*lineariser.options.displaced, *fitted)
        state = solve(as_it_is(lineariser.obs, state, known), weights=result.fit.weights).estimate.state
    residual = lineariser.evaluate(Estimate(state, result.fit.coefficients)).residual
    covariance = result.covariance + np.outer(left_out, left_out)
    return replace(result, state=state, covariance=covariance, own_fit=replace(result.fit, residual=residual))


def with_estimates(model: EffectModel, fitted: CalibratedCell) -> EffectModel:
    """The model with the coefficients of a calibration; terms that this does not have stay."""
    std = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    free = {name: float(std[j]) for j, name in enumerate(fitted.names)}
    found = fitted.fit.coefficients
    blocks = fitted.layout.blocks[len(fitted.layout.blocks) - len(found) :]
    value = {name: float(v) for b, c in zip(blocks, found, strict=True) for name, v in zip(b.names, c, strict=True)}
    coefficients = [np.array([value.get(name, c) for name, c in zip(t.names, t.coefficients, strict=True)]) for t in model.terms]
    return model.with_coefficients(coefficients, [np.array([free.get(name, 0.0) for name in t.names]) for t in model.terms])


def with_length_uncertainty(result: CalibratedCell) -> CalibratedCell:
    """The result with the covariances of the hand-eye transform and the stations enlarged; as it is without a known length."""
    obs = result.fit.observations
    sigma = known_length_sigma(obs)
    if sigma is None:
        return result
    step = max(sigma, LEAST_STEP)
    artefacts = tuple(a if a.certified else replace(a, centres=(1 + step) * a.centres) for a in obs.cell.artefacts)
    scaled = replace(obs, xyz=(1 + step) * obs.xyz, cell=replace(obs.cell, artefacts=artefacts))
    larger = adjust_recording(scaled, replace(result.fit.options, refuse=False)).state
    by_scale = np.zeros(len(result.names))
    twist = se3.coordinates(se3.inverse(result.state.T_flange_scanner) @ larger.T_flange_scanner) * sigma / step
    for name, value in zip(TWIST, twist, strict=True):
        if name in result.names:
            by_scale[result.names.index(name)] = value
    stations = result.fit.station_covariance.copy()
    for s in np.flatnonzero(np.einsum("sii->s", stations) > 0):
        moved = se3.coordinates(se3.inverse(result.state.T_base_station[s]) @ larger.T_base_station[s]) * sigma / step
        stations[s] += np.outer(moved, moved)
    fit = replace(result.fit, station_covariance=stations)
    return replace(result, covariance=result.covariance + np.outer(by_scale, by_scale), own_fit=fit)
