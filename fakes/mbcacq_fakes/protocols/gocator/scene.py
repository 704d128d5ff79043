"""What a fake sensor on its own looks at."""

from __future__ import annotations

import numpy as np

from mbcacq_fakes.world.frame import ScannerFrame

BALL_MM, FIELD_MM, PLATE_Z_MM = 20.0, (100.0, 75.0), -40.0


def ball_on_plate(rows: int, columns: int, noise_mm: float = 0.005) -> ScannerFrame:
    """A ball of radius BALL_MM, centre (10, -5, 0), over a plate; the ball's shadow and steep flank are not measured."""
    y, x = np.meshgrid(np.linspace(-0.5, 0.5, rows) * FIELD_MM[1], np.linspace(-0.5, 0.5, columns) * FIELD_MM[0], indexing="ij")
    height_squared = BALL_MM**2 - (x - 10) ** 2 - (y + 5) ** 2
    on_ball = height_squared > (0.35 * BALL_MM) ** 2
    z = np.where(on_ball, np.sqrt(np.maximum(height_squared, 0)), PLATE_Z_MM)
    z[(height_squared > -0.3 * BALL_MM**2) & ~on_ball] = np.nan
    z += np.random.default_rng(0).normal(0, noise_mm, z.shape)
    grey = np.where(on_ball, 200, 90).astype(np.uint8)
    return ScannerFrame(np.stack([x, y, z], axis=2).astype(np.float32), grey)
