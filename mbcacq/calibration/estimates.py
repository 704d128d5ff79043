"""A model of effects with the coefficients that a calibration estimated."""

from __future__ import annotations

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.effects.effect_model import EffectModel


def with_estimates(model: EffectModel, fitted: CalibratedCell) -> EffectModel:
    """The model with the coefficients of a calibration that has its terms."""
    std = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    free = {name: float(std[j]) for j, name in enumerate(fitted.names)}
    found = fitted.fit.coefficients
    blocks = fitted.layout.blocks[len(fitted.layout.blocks) - len(found) :]
    value = {name: float(v) for b, c in zip(blocks, found, strict=True) for name, v in zip(b.names, c, strict=True)}
    coefficients = [np.array([value[name] for name in t.names]) for t in model.terms]
    return model.with_coefficients(coefficients, [np.array([free.get(name, 0.0) for name in t.names]) for t in model.terms])
