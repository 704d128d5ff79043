"""What a diagnosis starts from: the cell with geometry alone, as ``mbcacq.calibrate`` has it of the same recording.

The keys, names and units are those of result.json (format 'mbcacq-result/1').
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from mbcacq.calibration.calibration_fit import CalibrationFit, Parameter
from mbcacq.geometry.chain import PARAMETERS

OF_THE_CELL = 2  # first blocks of the parameters: the arm and the hand-eye transform; balls follow


@dataclass(frozen=True)
class EstimatedNoise:
    """Standard deviations. scanner_mm: (3,) of a centre along the instrument's axes; joint_rad: (n,) repeatability of each axis; turn_rad:
    of a measured orientation about each axis, None where none was measured."""

    scanner_mm: tuple[float, ...]
    joint_rad: tuple[float, ...]
    turn_rad: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON content; without 'turn_rad' where no orientation was measured."""
        return {key: value for key, value in vars(self).items() if value is not None}


@dataclass(frozen=True)
class GeometryAlone:
    """The cell of one recording before any effect.

    poses, centres: that took part; a search for effects may begin with more centres, since an effect may be what puts them off. rms_mm: of
    3D distances; chi2, dof: of the fit. calibrated: MD-H rows by parameter, (n,) rad or mm. T_flange_scanner: (4, 4) mm.
    parameters: of the arm and the hand-eye transform.
    """

    poses: int
    centres: int
    rms_mm: float
    chi2: float
    dof: int
    noise: EstimatedNoise
    calibrated: Mapping[str, tuple[float, ...]]
    T_flange_scanner: tuple[tuple[float, ...], ...]
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, fit: CalibrationFit) -> Self:
        """Of a calibration without effects."""
        turn = fit.noise.turn if fit.residual.shape[1] == 6 else None
        named = {name for block in fit.layout.blocks[:OF_THE_CELL] for name in block.names}
        return cls(
            poses=fit.used_poses,
            centres=int(fit.used.sum()),
            rms_mm=fit.rms_mm,
            chi2=float(fit.chi2),
            dof=fit.dof,
            noise=EstimatedNoise(tuple(fit.noise.point.tolist()), tuple(fit.noise.joint.tolist()), turn),
            calibrated={p: tuple(getattr(fit.state.chain, p).tolist()) for p in PARAMETERS},
            T_flange_scanner=tuple(tuple(row) for row in fit.state.T_flange_scanner.tolist()),
            parameters=tuple(p for p in fit.parameters if p.name in named),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON content."""
        return {**vars(self), "noise": self.noise.to_dict(), "parameters": [p.to_dict() for p in self.parameters]}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        """Of what ``to_dict`` gave, once it was JSON. Raises KeyError where a key is missing."""
        noise, known = content["noise"], [f.name for f in fields(Parameter)]
        return cls(
            poses=content["poses"],
            centres=content["centres"],
            rms_mm=np.nan if content["rms_mm"] is None else content["rms_mm"],
            chi2=content["chi2"],
            dof=content["dof"],
            noise=EstimatedNoise(tuple(noise["scanner_mm"]), tuple(noise["joint_rad"]), noise.get("turn_rad")),
            calibrated={p: tuple(content["calibrated"][p]) for p in PARAMETERS},
            T_flange_scanner=tuple(tuple(row) for row in content["T_flange_scanner"]),
            parameters=tuple(Parameter(**{key: p[key] for key in known if key in p}) for p in content["parameters"]),
        )
