"""The options of driver ``gopxl`` as a plan gives them, checked before anything is opened."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mbcacq_gocator.snapshot_options import SnapshotOptions


class GoPxLOptions(SnapshotOptions):
    """mode: surface takes scans by software trigger, profile streams profiles as the job triggers them. data_port: 0 takes the one that
    the sensor names. source: id of the data source, '' for the scanner's own surface or profile. uniform: a height map, or profiles in
    equal steps of x, instead of a point cloud. right_handed: turn x of the sensor's left-handed frame round. The others: see
    SnapshotOptions.
    """

    control_port: int = Field(default=3600, ge=1, le=65535, strict=True)
    data_port: int = Field(default=0, ge=0, le=65535, strict=True)
    mode: Literal["surface", "profile"] = "surface"
    source: str = ""
    uniform: bool = Field(default=False, strict=True)
    right_handed: bool = Field(default=True, strict=True)
    discovery_port: int = Field(default=3320, ge=1, le=65535, strict=True)
    discovery_listen_port: int = Field(default=3320, ge=0, le=65535, strict=True)
