"""The options of driver ``gopxl`` as a plan gives them, checked before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mbcacq_gocator.option_checks import WHOLE, SensorOptions, check, flag, number, text

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
class GoPxLOptions(SensorOptions):
    """data_port: 0 takes the one that the sensor names. source: id of the data source, '' for the scanner's own surface. uniform: a height
    map instead of a point cloud. right_handed: turn x of the sensor's left-handed frame round. The others: see SensorOptions.
    """

    control_port: int = 3600
    data_port: int = 0
    source: str = ""
    uniform: bool = False
    right_handed: bool = True
    discovery_port: int = 3320
    discovery_listen_port: int = 3320

    @classmethod
    def read(cls, name: str, given: Mapping[str, Any]) -> GoPxLOptions:
        """Raises ConfigError naming the option that is wrong."""
        check(name, cls, given, CHECKS)
        return cls(**given)
