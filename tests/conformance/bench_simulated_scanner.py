"""The scanner of no maker that a dry run takes, in front of one ball."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from mbcacq_fakes.cell.simulated_scanner import SimulatedScanner
from mbcacq_fakes.world.frame import ScannerFrame

from mbcacq.conformance import Stand

PIXELS = np.zeros((4, 5, 3), dtype=np.float32)
PIXELS[..., 2] = np.arange(20).reshape(4, 5)
PIXELS[0, 0] = np.nan


@contextmanager
def simulated_scanner() -> Iterator[Stand]:
    def make(model: str = "", **more: Any) -> SimulatedScanner:
        return SimulatedScanner("scanner", model, {"expose": lambda exposure_us: ScannerFrame(PIXELS), **more})

    def use(scanner: SimulatedScanner) -> None:
        scan = scanner.capture()
        assert scan.points[:, 2].tolist() == list(range(1, 20))
        assert scan.pixel is not None
        assert scan.pixel.tolist() == list(range(1, 20))

    yield Stand(make, use, begin=lambda scanner: scanner.capture())
