"""One exposure of a fake scanner, before any protocol gets hold of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class ScannerFrame:
    """What the world shows to a scanner server.

    xyz: (L, W, 3) float32 mm, scanner frame, rows along y and columns along x, NaN where nothing was measured.
    intensity: (L, W) uint8, or None for a world without it. time_s: the world's clock at the exposure.
    measurements: numbers that tools inside the sensor computed (mm, deg...), by measurement id; NaN is an invalid one.
    """

    xyz: np.ndarray
    intensity: np.ndarray | None = None
    time_s: float = 0.0
    measurements: dict[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.xyz.ndim != 3 or self.xyz.shape[2] != 3:
            raise ValueError(f"xyz must be (L, W, 3), got {self.xyz.shape}")
        if self.intensity is not None and self.intensity.shape != self.xyz.shape[:2]:
            raise ValueError(f"intensity must be {self.xyz.shape[:2]}, got {self.intensity.shape}")
