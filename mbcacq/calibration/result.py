"""The calibrated cell, and everything that says how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbcacq.calibration import result_io
from mbcacq.calibration.calibration_fit import CalibrationFit, Parameter, Rejected

__all__ = ["Calibration", "Parameter", "Rejected"]


@dataclass(frozen=True)
class Calibration(CalibrationFit):
    """Result of :func:`mbcacq.calibration.calibrate`; its fields are those of :class:`CalibrationFit`."""

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json, format 'mbcacq-result/1'; see :mod:`mbcacq.calibration.result_io`."""
        return result_io.to_dict(self)
