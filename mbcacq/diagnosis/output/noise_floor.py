"""How far the model stays above the noise on held-out data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.quantities import K, measured, micrometres


@dataclass(frozen=True)
class NoiseFloor:
    """3D rms (mm) on held-out data after the model, the rms that noise alone would leave, and its expanded uncertainty (0: not known).

    chi2_dof: of the same data. It also knows how uncertain the fit is, which few poses leave more uncertain than the noise; None where
    that is not asked. expanded_chi2_dof: expanded uncertainty of one that is 1.
    """

    after_mm: float
    floor_mm: float
    expanded_mm: float = 0.0
    chi2_dof: float | None = None
    expanded_chi2_dof: float = 0.0

    @classmethod
    def of(cls, after_mm: float, floor_mm: float, centres: int, chi2_dof: float | None = None) -> NoiseFloor:
        """centres: how many took part; the rms of 3 N coordinates of normal noise has the relative standard deviation 1 / sqrt(6 N)."""
        relative = K / np.sqrt(6.0 * centres) if centres else 0.0
        return cls(after_mm, floor_mm, relative * floor_mm, chi2_dof, 2.0 * relative)

    @property
    def above_mm(self) -> float:
        """How far the rms is above that of noise alone; 0 where it is within its uncertainty."""
        above = self.after_mm - self.floor_mm
        return above if above > self.expanded_mm else 0.0

    @property
    def fit_is_the_rest(self) -> bool:
        """Whether the rms is above that of noise alone, and no more than an uncertain fit allows."""
        return bool(self.above_mm) and self.chi2_dof is not None and not self.is_excess(self.chi2_dof)

    def is_excess(self, chi2_dof: float) -> bool:
        """Whether chi2 per degree of freedom of the same data is more than noise and an uncertain fit allow."""
        return chi2_dof > 1.0 + self.expanded_chi2_dof

    @property
    def noise(self) -> str:
        """The rms that noise alone would leave, with its uncertainty."""
        return measured(1e3 * self.floor_mm, 1e3 * self.expanded_mm, "µm") if self.expanded_mm else micrometres(self.floor_mm)

    @property
    def distance(self) -> str:
        """How near the model comes to the noise: 'down to the measured noise', or how far above it."""
        if not self.above_mm:
            return "down to the measured noise"
        if self.fit_is_the_rest:
            return "down to the measured noise and the uncertainty of the fit"
        above = measured(1e3 * self.above_mm, 1e3 * self.expanded_mm, "µm") if self.expanded_mm else micrometres(self.above_mm)
        return f"to {above} (k = 2; {self.above_mm / self.floor_mm:.0%}) above the measured noise"
