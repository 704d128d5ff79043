"""What is published of an adjusted cell: the nominal arm, a scale from one known length, effects with their estimates.

Two kinds of cells have a larger covariance than their adjustment. The nominal arm has link errors that are uncertain and are not applied:
who asked for the hand-eye alone goes on with the nominal arm, so every uncertainty is the second moment of the error about it. A scale from
one known length is as uncertain as the length and as its mean over the scans. The hand-eye transform follows it; by how much is seen from a
second adjustment with all lengths a little larger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import HAND_EYE, Estimate
from mbcacq.estimation.scan_scale import known_length_sigma
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import solve
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER
from mbcacq.model.observations import Observations


def with_nominal_arm(result: CalibratedCell, lineariser: Lineariser) -> CalibratedCell:
    """The result with the nominal arm in place of its most probable one.

    The covariance C of the parameters' errors about their estimate becomes C + u u' with u the estimated link errors that are left out: the
    second moment about what is published. Residuals are those of the nominal arm; chi square stays that of the model with link errors,
    which is the one that says whether the data contradict the noise.

    Parameters
    ----------
    result : CalibratedCell
        With link errors as random effects (``CalibrationOptions(kinematics=False)``).
    lineariser : Lineariser
        Lineariser of the same recording and layout.
    """
    left_out = np.zeros(result.layout.size)
    chain = result.layout.blocks[0]
    left_out[: int(chain.free.sum())] = result.errors.reshape(-1)[chain.free]
    state = _replaced(replace(result.state, chain=result.nominal), lineariser, result)
    residual = lineariser.evaluate(Estimate(state, result.fit.coefficients)).residual
    covariance = result.covariance + np.outer(left_out, left_out)
    return replace(result, state=state, covariance=covariance, own_fit=replace(result.fit, residual=residual))


def _replaced(state: CellState, lineariser: Lineariser, result: CalibratedCell) -> CellState:
    """The state with the places of the artefacts as the nominal arm sees them. The place of an instrument is a result itself, and stays."""
    if lineariser.obs.cell.measurement != ARTEFACT_IN_SCANNER:
        return state
    hold = tuple(f"{name}.{c}" for name in _mounts(result) for c in HAND_EYE)
    options = CalibrationOptions(kinematics=False, discrepancy=False, balls=False, hold=hold, displaced=lineariser.options.displaced)
    layout = parameters.build(lineariser.obs, options)
    noise = Noise(np.ones(3), np.full(result.nominal.n, 1e-12), 1e-2)
    at = system(Lineariser(lineariser.obs, layout, options), Estimate(state), noise, result.fit.weights)
    return solve(at).estimate.state


def _mounts(result: CalibratedCell) -> list[str]:
    """Names of the hand-eye transforms: one, or one for each of several recordings."""
    return list(dict.fromkeys(name.rsplit(".", 1)[0] for name in result.layout.blocks[1].names))


def with_estimates(model: EffectModel, fitted: CalibratedCell) -> EffectModel:
    """The model with the coefficients of a calibration that has its terms."""
    std = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    free = {name: float(std[j]) for j, name in enumerate(fitted.names)}
    found = fitted.fit.coefficients
    blocks = fitted.layout.blocks[len(fitted.layout.blocks) - len(found) :]
    value = {name: float(v) for b, c in zip(blocks, found, strict=True) for name, v in zip(b.names, c, strict=True)}
    coefficients = [np.array([value[name] for name in t.names]) for t in model.terms]
    return model.with_coefficients(coefficients, [np.array([free.get(name, 0.0) for name in t.names]) for t in model.terms])


LEAST_STEP = 1e-5  # relative; below, rounding would show
TWIST = ("x", "y", "z", "rx", "ry", "rz")


def with_length_uncertainty(result: CalibratedCell, refitted: Callable[[Observations], CellState]) -> CalibratedCell:
    """The result with the covariances of the hand-eye transform and the stations enlarged; as it is without a known length.

    refitted: the state of the cell from observations, under the same options.
    """
    obs = result.fit.observations
    sigma = known_length_sigma(obs)
    if sigma is None:
        return result
    step = max(sigma, LEAST_STEP)
    artefacts = tuple(a if a.certified else replace(a, centres=(1 + step) * a.centres) for a in obs.cell.artefacts)
    larger = refitted(replace(obs, xyz=(1 + step) * obs.xyz, cell=replace(obs.cell, artefacts=artefacts)))
    by_scale = np.zeros(len(result.names))
    twist = _twist(result.state.T_flange_scanner, larger.T_flange_scanner) * sigma / step
    for name, value in zip((f"hand_eye.{part}" for part in TWIST), twist, strict=True):
        if name in result.names:
            by_scale[result.names.index(name)] = value
    stations = result.fit.station_covariance.copy()
    for s in np.flatnonzero(np.einsum("sii->s", stations) > 0):
        moved = _twist(result.state.T_base_station[s], larger.T_base_station[s]) * sigma / step
        stations[s] += np.outer(moved, moved)
    fit = replace(result.fit, station_covariance=stations)
    return replace(result, covariance=result.covariance + np.outer(by_scale, by_scale), own_fit=fit)


def _twist(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(6,) mm and rad behind ``before`` that leads to ``after``."""
    off = se3.inverse(before) @ after
    return np.r_[off[:3, 3], se3.rotation_log(off[:3, :3])]
