"""A calibration that leaves the arm as it is: its link errors are uncertain, and their best estimate is not applied.

Hand-eye and stations come from a model in which the links err at random. Who asked for the hand-eye alone goes on with the nominal arm, so
what is published is the nominal arm, and every uncertainty is the second moment of the error about it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import HAND_EYE, Estimate
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import solve
from mbcacq.model.cell import ARTEFACT_IN_SCANNER


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
