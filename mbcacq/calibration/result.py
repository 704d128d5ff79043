"""The calibrated cell, and everything that says how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mbcacq.calibration import notebook, result_io
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.calibration_fit import CalibrationFit, Parameter, Rejected
from mbcacq.calibration.cell_methods import CalibratedCellMethods
from mbcacq.calibration.sealed_json import sealed_text
from mbcacq.calibration.with_effects import Fit, refitted
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError

__all__ = ["Calibration", "Parameter", "Rejected"]


class HasModel(Protocol):
    """A diagnosis: what it found, as a model of effects."""

    @property
    def model(self) -> EffectModel | None: ...


@dataclass(frozen=True, repr=False)
class Calibration(CalibrationFit, CalibratedCellMethods):
    """Result of ``mbcacq.calibrate``; its fields are those of ``mbcacq.calibration.calibration_fit.CalibrationFit``, and ``fit``, which
    calibrates observations under any options as it was made itself."""

    fit: Fit[Calibration] | None = None

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json, format 'mbcacq-result/1'; see ``mbcacq.calibration.result_io``."""
        return result_io.to_dict(self)

    def to_json(self) -> str:
        """``to_dict`` as JSON text, with its checksum."""
        return sealed_text(self.to_dict())

    def with_effects(self, found: EffectModel | HasModel, *, hold: bool = False) -> Calibration:
        """The same recording calibrated with effects as terms of the cell. found: a model of effects, or a diagnosis that holds one.
        hold: keep their coefficients as they are. Raises ConfigError where there are none, or they are of another arm.
        """
        model = found if isinstance(found, EffectModel) else found.model
        if not model:
            raise ConfigError("this diagnosis found no effects that a calibration could take")
        if self.fit is None:
            raise ConfigError("this calibration does not know how it was made; call mbcacq.calibrate with effects")
        return refitted(self.observations, self.options, model, self.fit, hold=hold)

    @staticmethod
    def from_json(source: str | Path) -> CalibratedCell:
        """The calibrated cell of a result, without the observations it came from; see ``CalibratedCell.from_json``."""
        return CalibratedCell.from_json(source)

    def __repr__(self) -> str:
        return (
            f"Calibration({self.cell.robot.name}: {int(self.used.sum())} centres, residual {self.rms_mm:.4f} mm rms, "
            f"{len(self.names)} parameters, rank {self.rank})"
        )

    def _repr_html_(self) -> str:
        return result_io.html(self.to_dict()) + notebook.paragraph(repr(self))
