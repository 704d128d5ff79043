"""How far the model stays above the noise on held-out data, and which effects are a trend and no finding with a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.quantities import K, measured, micrometres

NOT_SIZES = ("order", "phase_deg", "at_pose", "time_constant_s", "transition_Nm", "breakpoint_Nm", "zero_deg")


TREND = "a trend: no figure is beyond its expanded uncertainty (k = 2)"


@dataclass(frozen=True)
class NoiseFloor:
    """3D rms (mm) on held-out data after the model, the rms that noise alone would leave, and its expanded uncertainty (0: not known)."""

    after_mm: float
    floor_mm: float
    expanded_mm: float = 0.0

    @classmethod
    def of(cls, after_mm: float, floor_mm: float, centres: int) -> NoiseFloor:
        """centres: how many took part; the rms of 3 N coordinates of normal noise has the relative standard deviation 1 / sqrt(6 N)."""
        return cls(after_mm, floor_mm, K * floor_mm / np.sqrt(6.0 * centres) if centres else 0.0)

    @property
    def above_mm(self) -> float:
        """How far the rms is above that of noise alone; 0 where it is within its uncertainty."""
        above = self.after_mm - self.floor_mm
        return above if above > self.expanded_mm else 0.0

    @property
    def noise(self) -> str:
        """The rms that noise alone would leave, with its uncertainty."""
        return measured(1e3 * self.floor_mm, 1e3 * self.expanded_mm, "µm") if self.expanded_mm else micrometres(self.floor_mm)

    @property
    def distance(self) -> str:
        """How near the model comes to the noise: 'down to the measured noise', or how far above it."""
        if not self.above_mm:
            return "down to the measured noise"
        above = measured(1e3 * self.above_mm, 1e3 * self.expanded_mm, "µm") if self.expanded_mm else micrometres(self.above_mm)
        return f"to {above} (k = 2; {self.above_mm / self.floor_mm:.0%}) above the measured noise"


def is_trend(parameters: Mapping[str, tuple[Iterable[float | None], Iterable[float | None]]]) -> bool:
    """Whether no parameter that is a size reaches its expanded uncertainty: the effect helps, but no figure of it may be relied on.

    parameters: by name, the values of its components and their standard deviations.
    """
    sizes = [pairs for name, pairs in parameters.items() if name.rpartition(".")[2] not in NOT_SIZES]
    known = [(v, s) for values, stds in sizes for v, s in zip(values, stds, strict=False) if v is not None and s]
    return bool(known) and all(abs(v) < K * s for v, s in known)


def is_trend_in_json(effect: Mapping[str, Any]) -> bool:
    """``is_trend`` of an effect as a diagnosis is written: 'parameters' with 'value' and 'std', numbers or lists of them."""
    return is_trend({name: components(entry) for name, entry in effect["parameters"].items()})


def components(entry: Mapping[str, Any]) -> tuple[list[float | None], list[float | None]]:
    """Values and standard deviations of the components of a parameter as a diagnosis is written."""
    values, stds = (v if isinstance(v, list) else [v] for v in (entry["value"], entry["std"]))
    return values, stds
