"""A scanner of no maker behind the plain interface of a scanner driver: what a dry run takes where a driver has no fake at the wire.

It has no wire: it asks the fake cell for an exposure of the world, taken with the plan's field of view, noise, resolution and scan time.
A real run cannot use it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mbcacq.devices import ConfigError, ContextDevice, Description, Field, Scan
from mbcacq_fakes.cell.simulated_clock import SimulatedClock
from mbcacq_fakes.world.frame import ScannerFrame


class SimulatedScanner(ContextDevice):
    """Implements mbcacq.devices.Scanner. options, from the fake cell: expose(exposure_us), which gives a frame; clock and scan_time_s, by
    which an exposure takes time; others are of the plan's own driver."""

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model = name, model
        self._expose: Callable[[float], ScannerFrame] | None = options.get("expose")
        self._clock: SimulatedClock | None = options.get("clock")
        self._scan_time = float(options.get("scan_time_s", 0.0))
        self._lock, self._connected, self._frames = threading.Lock(), False, 0

    def describe(self) -> Description:
        return Description(
            "scanner",
            self._model or "simulated scanner",
            (Field("points", "mm", (3,), meaning="in the scanner frame"), Field("intensity", "1", (), meaning="0 to 255")),
            serial="simulated",
        )

    def connect(self) -> None:
        """Raises ConfigError outside a dry run."""
        if self._expose is None:
            raise ConfigError(
                "the simulated scanner is there in a dry run only; run the plan with --dry-run, or name your scanner's driver "
                "('folder' takes the clouds that its own program saves)"
            )
        self._connected = True

    def capture(self, exposure_us: float | None = None) -> Scan:
        """One exposure of the fake world. Raises ConfigError before ``connect``."""
        if not self._connected or self._expose is None:
            raise ConfigError(f"scanner '{self._name}' is not connected; connect it first")
        with self._lock:
            frame = self._expose(exposure_us or 0.0)
            if self._clock is not None:
                self._clock.wait(self._scan_time)
            self._frames += 1
            return scan_of(frame, self._frames, exposure_us or 0.0)

    def stop(self) -> None:
        """Nothing is under way between two exposures."""

    def close(self) -> None:
        self._connected = False


def scan_of(frame: ScannerFrame, number: int, exposure_us: float) -> Scan:
    """The valid points of a frame as a scan."""
    xyz = frame.xyz.reshape(-1, 3)
    pixel = np.flatnonzero(np.isfinite(xyz).all(axis=1)).astype(np.int32)
    intensity = None if frame.intensity is None else frame.intensity.reshape(-1)[pixel]
    return Scan(xyz[pixel].astype(np.float32), intensity, frame.xyz.shape[:2], pixel, frame.time_s, number, exposure_us)
