"""Options that the sensors of both generations have."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SnapshotOptions:
    """address: host name or IPv4; '' looks for the sensor with ``serial`` by broadcast. job: '' keeps the loaded one. allow_aligned: accept
    points that are not in the sensor's own coordinates. timeout_s: longest wait for a scan. reply_limit_s: caps the protocol's own time
    limit of every request. grace_s: added to all of them, for a sensor that a busy computer plays. retries: attempts after a dropped
    connection.
    """

    address: str = ""
    serial: int | None = None
    job: str = ""
    exposure_us: float | None = None
    temperature_warning_C: float | None = None
    temperature_stop_C: float | None = None
    allow_aligned: bool = False
    restore: bool = True
    timeout_s: float = 10.0
    connect_timeout_s: float = 3.0
    reply_limit_s: float | None = None
    grace_s: float = 0.0
    retries: int = 2
    broadcast: str = "255.255.255.255"
