"""The calibrated cell, and everything that says how far to trust it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbcacq.calibration import notebook, result_io
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.calibration_fit import CalibrationFit, Parameter, Rejected
from mbcacq.calibration.cell_methods import CalibratedCellMethods

__all__ = ["Calibration", "Parameter", "Rejected"]


@dataclass(frozen=True, repr=False)
class Calibration(CalibrationFit, CalibratedCellMethods):
    """Result of :func:`mbcacq.calibrate`; its fields are those of :class:`mbcacq.calibration.calibration_fit.CalibrationFit`."""

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json, format 'mbcacq-result/1'; see :mod:`mbcacq.calibration.result_io`."""
        return result_io.to_dict(self)

    def to_json(self) -> str:
        """:meth:`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1)

    @staticmethod
    def from_json(source: str | Path) -> CalibratedCell:
        """The calibrated cell of a result, without the observations it came from; see :meth:`CalibratedCell.from_json`."""
        return CalibratedCell.from_json(source)

    def __repr__(self) -> str:
        return (
            f"Calibration({self.cell.robot.name}: {int(self.used.sum())} centres, residual {self.rms_mm:.4f} mm rms, "
            f"{len(self.names)} parameters, rank {self.rank})"
        )

    def _repr_html_(self) -> str:
        return result_io.html(self.to_dict()) + notebook.paragraph(repr(self))
