"""A calibrated cell read back from result.json: state, covariance and noise, without the observations they came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration import result_io
from mbcacq.calibration.cell_methods import CalibratedCellMethods
from mbcacq.calibration.sealed_json import sealed_text, unsealed
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.model.json_text import damage, read_json
from mbcacq.model.observations import Observations


@dataclass(frozen=True, repr=False)
class CalibratedCell(CalibratedCellMethods):
    """What ``mbcacq.calibration.calibrated.Calibrated`` describes. stations: the ids of ``state.T_base_station`` (S, 4, 4); ball_ids:
    those of ``state.balls`` (K, 3) mm. content: the whole of result.json, as it was read. effects: as terms of the cell, or None."""

    robot: str
    state: CellState
    preliminary: CellState
    layout: ParameterLayout
    covariance: np.ndarray
    noise: Noise
    stations: tuple[str, ...]
    ball_ids: tuple[int, ...]
    content: dict[str, Any] = field(default_factory=dict)
    effects: EffectModel | None = None

    @classmethod
    def from_dict(cls, content: dict[str, Any], source: str = "the calibration result") -> CalibratedCell:
        """The cell of a result's content. source: how a message calls it. Raises ConfigError where this is no result of a calibration, or
        a damaged one."""
        state = result_io.state_from_dict(content)
        try:
            nominal, T = result_io.chain_of(content, "nominal"), result_io.transform(content["preliminary"]["T_flange_scanner"])
            layout = result_io.layout_from_dict(content)
            covariance = np.array(content["covariance"], dtype=float).reshape(layout.size, layout.size)
            noise = result_io.noise_from_dict(content["noise"])
            robot = str(content["robot"]["name"])
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{source} is damaged ({damage(error)}); write it anew with mbcacq calibrate") from error
        first = CellState(nominal, T, state.T_base_station, state.balls)
        stations = tuple(str(s["id"]) for s in content["stations"])
        effects = result_io.effects_of(content)
        return cls(
            robot=robot,
            state=state,
            preliminary=first,
            layout=layout,
            covariance=covariance,
            noise=noise,
            stations=stations,
            ball_ids=tuple(b["id"] for b in content["balls"]),
            content=content,
            effects=effects,
        )

    @classmethod
    def from_json(cls, source: str | Path, *, any_of_them: bool = False) -> CalibratedCell:
        """The cell of a result's JSON text, of a result.json, or of a run folder that holds one; of one of several recordings by its number
        (``result.json#2``), or without where ``any_of_them`` will do, since they share the arm. Raises ConfigError."""
        if isinstance(source, str) and source.lstrip().startswith("{"):
            content = read_json(source, "the calibration result", "give the content of a result.json")
            return cls.from_dict(unsealed(content, Path("the calibration result")))
        return cls.from_dict(result_io.read_result(Path(source), any_of_them=any_of_them), str(source))

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json."""
        return self.content

    def to_json(self) -> str:
        """``to_dict`` as JSON text, with its checksum."""
        return sealed_text(self.content)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the covariance."""
        return self.layout.names

    @property
    def station_places(self) -> dict[str, np.ndarray]:
        """T_base_station (4, 4) by id, of the stations that took part."""
        return dict(zip(self.stations, self.state.T_base_station, strict=True))

    def took_part(self, observations: Observations) -> bool | None:
        """False where none of these stations belongs to the calibration; else None: result.json does not list poses."""
        measured = {observations.cell.stations[s].id for s in np.unique(observations.station)}
        return None if measured & set(self.stations) else False

    def __repr__(self) -> str:
        return f"CalibratedCell({self.robot}: {len(self.names)} parameters, {len(self.stations)} stations)"

    def _repr_html_(self) -> str:
        return result_io.html(self.content)
