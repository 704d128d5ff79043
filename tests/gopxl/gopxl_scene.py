"""What the fake sensor of these tests sees."""

import numpy as np
from mbcacq_fakes.world.frame import ScannerFrame

VOLUME = np.array([-20.0, -20, 0]), np.array([20.0, 20, 50])


def tilted_plane(number: int = 0) -> ScannerFrame:
    """20 x 12 points with a hole, another height for every number."""
    y, x = np.mgrid[:12, :20].astype(np.float32)
    xyz = np.stack([x * 0.5 - 4, y * 0.5 - 3, 20 + 0.1 * x - 0.05 * y + 0.5 * number], axis=2)
    xyz[3:6, 7:11] = np.nan
    return ScannerFrame(xyz, (10 * y + x).astype(np.uint8), measurements={1: 12.5})
