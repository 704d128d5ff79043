"""How far the model stays above the noise on held-out data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.quantities import K, measured, micrometres


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
