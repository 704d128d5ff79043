"""What a calibrated cell offers to those who use it, whether just computed or read from result.json."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.model.observations import Observations


class Calibrated(Protocol):
    """A calibrated cell: ``mbcacq.calibration.result.Calibration`` or ``mbcacq.calibration.calibrated_cell.CalibratedCell``.

    robot: name of the arm. state: chain with its errors, T_flange_scanner (4, 4), stations, balls. preliminary: nominal arm, hand-eye
    fitted alone. layout: names and freedom of the parameters; covariance: (g, g) of the free ones, in the order of ``layout.names``.
    noise: of a centre and the joints. effects: what the arm does beyond its geometry, or None. station_places: T_base_station (4, 4) by
    id, of the stations that took part.
    """

    @property
    def robot(self) -> str: ...

    @property
    def state(self) -> CellState: ...

    @property
    def preliminary(self) -> CellState: ...

    @property
    def layout(self) -> ParameterLayout: ...

    @property
    def covariance(self) -> np.ndarray: ...

    @property
    def noise(self) -> Noise: ...

    @property
    def effects(self) -> EffectModel | None: ...

    @property
    def station_places(self) -> dict[str, np.ndarray]: ...

    def took_part(self, observations: Observations) -> bool | None:
        """Whether any of these poses took part in the calibration; None where that is not known."""
        ...
