"""The options of driver ``gopxl`` as a plan gives them, checked before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbcacq_gocator.option_checks import WHOLE, check, flag, number, text

CHECKS = {
    "data_port": number(0, 65535, WHOLE),
    "discovery_listen_port": number(0, 65535, WHOLE),
    "job": text(),
    "source": text(),
    "uniform": flag,
    "right_handed": flag,
    "timeout_s": number(1e-3, 1e4),
    "connect_timeout_s": number(1e-3, 1e3),
    "reply_limit_s": number(1e-3, 1e3),
}


@dataclass(frozen=True, kw_only=True)
class GoPxLOptions:
    """address: host name or IPv4; '' looks for the sensor with ``serial`` by broadcast. data_port: 0 takes the one that the sensor names.

    job: '' keeps the loaded one. source: id of the data source, '' takes the scanner's own surface. uniform: a height map instead of
    a point cloud. right_handed: turn x of the sensor's left-handed frame round. allow_aligned: accept a sensor that was aligned, whose
    points are in the frame of that alignment. timeout_s: longest wait for a scan. reply_limit_s: caps the time limit of every request.
    grace_s: added to all of them, for a sensor that a busy computer plays. retries: attempts after a dropped connection.
    """

    address: str = ""
    serial: int | None = None
    control_port: int = 3600
    data_port: int = 0
    job: str = ""
    source: str = ""
    uniform: bool = False
    right_handed: bool = True
    allow_aligned: bool = False
    exposure_us: float | None = None
    temperature_warning_C: float | None = None
    temperature_stop_C: float | None = None
    restore: bool = True
    timeout_s: float = 10.0
    connect_timeout_s: float = 3.0
    reply_limit_s: float | None = None
    grace_s: float = 0.0
    retries: int = 2
    broadcast: str = "255.255.255.255"
    discovery_port: int = 3320
    discovery_listen_port: int = 3320

    @classmethod
    def read(cls, name: str, given: Mapping[str, Any]) -> GoPxLOptions:
        """Raises ConfigError naming the option that is wrong."""
        check(name, cls, given, CHECKS)
        return cls(**given)
