"""Methods that every calibrated cell has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mbcacq.calibration import notebook, uncertainty
from mbcacq.calibration.calibrated import Calibrated
from mbcacq.calibration.verification import Verification, verify
from mbcacq.model.observations import Observations

if TYPE_CHECKING:
    import plotly.graph_objects as go


class _Written(Protocol):
    def to_dict(self) -> dict[str, Any]: ...


class CalibratedCellMethods:
    """Methods of every calibrated cell. Lengths mm, angles rad."""

    def to_base(self: Calibrated, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Scanner points xyz (P, 3) mm seen from postures q (P, n) rad, in the base frame (P, 3) mm."""
        return uncertainty.to_base(self, q, xyz)

    def point_covariance(self: Calibrated, q: np.ndarray, xyz: np.ndarray, *, measuring: bool = False) -> np.ndarray:
        """(P, 3, 3) mm^2 covariance in the base of scanner points xyz (P, 3) mm seen from postures q (P, n) rad, by the calibrated
        parameters; with ``measuring`` also by the scanner's noise and the joints' repeatability of one measurement."""
        return uncertainty.point_covariance(self, q, xyz, measuring=measuring)

    def verify(self: Calibrated, observations: Observations, *, limit_mm: float | None = None) -> Verification:
        """Sphere spacing errors of a recording; see ``mbcacq.calibration.verification.verify``."""
        return verify(observations, self, limit_mm=limit_mm)

    def plot(self: _Written) -> go.Figure:
        """The errors of the arm's parameters that were identified, each with its U (k = 2), as a Plotly figure."""
        content = self.to_dict()
        return notebook.parameter_figure(f"{content['robot']['name']}: errors against the data sheet", content["parameters"])
