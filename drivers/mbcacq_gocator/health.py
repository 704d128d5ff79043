"""The health channel: a thread that keeps the newest value of every indicator."""

from __future__ import annotations

import threading
import time

import numpy as np

from mbcacq.devices import MbcacqError, hang_up
from mbcacq_gocator import wire
from mbcacq_gocator.decode import Health, decode

INDICATORS = {
    1003: "encoder",
    1005: "encoder_frequency",
    1010: "laser_safety",
    2000: "firmware_version",
    2002: "temperature_C",
    2003: "memory_used",
    2004: "memory_capacity",
    2005: "storage_used",
    2006: "storage_capacity",
    2007: "cpu_percent",
    2017: "uptime_s",
    2024: "digital_inputs",
    2028: "control_temperature_C",
    2404: "projector_temperature_C",
    20000: "state",
    20001: "speed",
    20002: "max_speed",
    20003: "spots",
    20005: "scan_count",
    20015: "points",
    20016: "max_points",
    20020: "overheat",
    21000: "processing_drops",
    21001: "latency_us",
    21002: "max_latency_us",
    21003: "bytes_out",
    21010: "trigger_drops",
    21011: "output_drops",
    21018: "snapshot_processing_us",
}
_HOTTEST_C = 200  # some firmware counts degrees, some hundredths: no sensor survives this many degrees
_SILENT_S = 10.0  # messages come about once a second
_MAX_MESSAGE, _MAX_NAMES = 64 * 1024, 4096
_FIRST_S = 3.0  # until the first one is there


class HealthReader:
    """Connects on ``open``; ``values()`` never waits, and is empty when the sensor has been silent for long.

    Losing the channel loses only these values, so it is no error of a scan.
    """

    def __init__(self, address: str, port: int, connect_timeout_s: float) -> None:
        self._address, self._port, self._connect_timeout_s = address, port, connect_timeout_s
        self._values: dict[str, float] = {}
        self._heard = self._opened = 0.0
        self._sock = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    def open(self) -> None:
        """Raises ConnectError if nothing listens."""
        self._sock = wire.connect(self._address, self._port, "health", self._connect_timeout_s)
        self._closing.clear()
        self._opened = time.monotonic()
        self._thread = threading.Thread(target=self._run, args=(self._sock,), name="gocator-health", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    @property
    def settled(self) -> bool:
        """Whether ``values`` can be judged: a message came over this connection, or has been due for long."""
        return self._heard > self._opened or time.monotonic() - self._opened > _FIRST_S

    def values(self) -> dict[str, float]:
        """Newest value by name; an indicator of a further instance is called ``name.instance``."""
        return dict(self._values) if time.monotonic() - self._heard < _SILENT_S else {}

    def close(self) -> None:
        self._closing.set()
        hang_up(self._sock)
        if self._thread is not None:
            self._thread.join(timeout=2.0)
        self._sock = self._thread = None

    def _run(self, sock) -> None:
        reader = wire.MessageReader(sock, "health message", self._closing.is_set, lambda kind: _MAX_MESSAGE)
        try:
            while not self._closing.is_set():
                reader.rewind()
                message, _ = decode(reader.read(float("inf")))
                if isinstance(message, Health):
                    self._values = newest(self._values, named(message.items))
                    self._heard = time.monotonic()
        except MbcacqError:
            pass  # values() goes empty by itself, and the next capture connects again
        finally:
            hang_up(sock)


def newest(known: dict[str, float], received: dict[str, float]) -> dict[str, float]:
    """Known values updated by those received. Names beyond the limit replace the ones that were longest without news."""
    merged = {**{name: value for name, value in known.items() if name not in received}, **received}
    return dict(list(merged.items())[-_MAX_NAMES:])


def named(items: np.ndarray) -> dict[str, float]:
    """Indicator values by name; temperatures in degrees whichever unit the firmware used."""
    values = {}
    for identifier, instance, value in items.tolist():
        name = INDICATORS.get(identifier, f"indicator_{identifier}")
        if name.endswith("_C") and abs(value) > _HOTTEST_C:
            value /= 100
        values[name if not instance else f"{name}.{instance}"] = float(value)
    return values
