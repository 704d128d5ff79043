"""Whether the noise that is stated of the instrument is that of the recording."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.estimation.options import Noise

WRONG = 1.5  # factor from which a statement is said to be wrong
SIGNIFICANT = 3.0  # standard deviations


def stated_noise_is_wrong(full: ModelFit, stated: Noise) -> str | None:
    """One sentence where the estimated noise is not what is stated; None where it is, or where nothing is stated."""
    linear = full.geometry_only.linear
    if linear.obs.cell.noise_mm is None:
        return None
    ratio = float(np.exp(np.mean(np.log(full.noise.point / stated.point))))
    sd = 1.0 / np.sqrt(2.0 * max(full.geometry_only.dof, 1.0))
    if abs(np.log(ratio)) < max(np.log(WRONG), SIGNIFICANT * sd):
        return None
    instrument = "scanner" if linear.width == 3 and linear.obs.cell.measurement != "target_in_base" else "instrument"
    found = np.sqrt(np.mean(full.noise.point**2))
    factor = f"{ratio:.2g} times" if ratio > 1 else f"1/{1 / ratio:.2g} of"
    return f"the noise of the {instrument} is {factor} what is stated: {found:.2g} mm an axis; correct noise_mm in cell.yaml"
