"""A calibration that leaves the arm as it is: its link errors are uncertain, and their best estimate is not applied.

Hand-eye and stations come from a model in which the links err at random. Who asked for the hand-eye alone goes on with the nominal arm, so
what is published is the nominal arm, and every uncertainty is the second moment of the error about it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.result import Calibration
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.parameters import Estimate


def with_nominal_arm(result: Calibration, lineariser: Lineariser) -> Calibration:
    """The result with the nominal arm in place of its most probable one.

    The covariance C of the parameters' errors about their estimate becomes C + u u' with u the estimated link errors that are left out: the
    second moment about what is published. Residuals are those of the nominal arm; chi square stays that of the model with link errors,
    which is the one that says whether the data contradict the noise.

    Parameters
    ----------
    result : Calibration
        With link errors as random effects (``CalibrationOptions(kinematics=False)``).
    lineariser : Lineariser
        Of the same recording and layout.
    """
    left_out = np.zeros(result.layout.size)
    chain = result.layout.blocks[0]
    left_out[: int(chain.free.sum())] = result.errors.reshape(-1)[chain.free]
    state = replace(result.state, chain=result.cell.robot.chain)
    _, residual = lineariser.residual(Estimate(state, result.coefficients))
    return replace(result, state=state, covariance=result.covariance + np.outer(left_out, left_out), residual=residual)
