"""Observations with the geometry that was fitted to them: what candidate effects are made from."""

from __future__ import annotations

from dataclasses import dataclass

from mbcacq.effects.covariates import Covariates, rank_in_time
from mbcacq.estimation.forward_model import CellState, Prediction

__all__ = ["Context", "rank_in_time"]


@dataclass(frozen=True)
class Context(Covariates):
    """Covariates of a recording with the geometry that was fitted to it, and the prediction by that geometry."""

    state: CellState
    prediction: Prediction
