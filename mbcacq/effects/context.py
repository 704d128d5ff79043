"""Observations with the geometry that was fitted to them: what candidate effects are made from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.effects.covariates import AXIS, TILT, Covariates
from mbcacq.effects.covariates import rank_in_time as rank_in_time
from mbcacq.estimation.forward_model import CellState, Prediction


@dataclass(frozen=True)
class Context(Covariates):
    """Covariates of a recording with the geometry that was fitted to it, and the prediction by that geometry."""

    state: CellState
    prediction: Prediction

    @cached_property
    def artefact_axis(self) -> np.ndarray:
        """(P, 3) z axis of the artefact that each pose looks at, in the scanner's axes."""
        scanner, station = self.prediction.T_base_scanner[:, :3, :3], self.prediction.T_base_station[:, :3, 2]
        return np.einsum("pji,pj->pi", scanner, station)

    def value(self, name: str) -> np.ndarray:
        """A covariate by its name, with those that follow from the fitted geometry; the others as of ``Covariates``."""
        if name in AXIS and self.scanner_on_flange:
            return self.artefact_axis[:, AXIS.index(name)]
        if name == TILT and self.scanner_on_flange:
            return np.arccos(np.clip(np.abs(self.artefact_axis[:, 2]), 0, 1))
        return super().value(name)
