"""Whether points are in the sensor's own coordinates, and if not, by which transformation they are turned and shifted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

from mbcacq.devices import ConfigError, ProtocolError
from mbcacq_gocator import commands, information, xmlfile
from mbcacq_gocator.control import ControlChannel
from mbcacq_gocator.files import LIVE_TRANSFORM, SensorFiles

_TERMS = ("X", "Y", "Z", "XAngle", "YAngle", "ZAngle")


@dataclass(frozen=True)
class Alignment:
    """aligned: what the sensor reports. transform: X, Y, Z in mm and the angles about them in deg, of the main sensor."""

    aligned: bool
    transform: tuple[float, ...]

    @classmethod
    def read(cls, control: ControlChannel, files: SensorFiles) -> Alignment:
        """Raises ProtocolError for a transformation that is not made of numbers, and what the channel raises."""
        states = information.parse_states(control.request(commands.STATES))
        return cls(states.get("alignment_state", 0) != 0, main_transform(files.read(LIVE_TRANSFORM)))

    @property
    def in_sensor_coordinates(self) -> bool:
        """Someone may also type a transformation into the web page without aligning."""
        return not self.aligned and not any(self.transform)

    def __str__(self) -> str:
        if self.in_sensor_coordinates:
            return "none"
        terms = ", ".join(f"{name} {value:g}" for name, value in zip(_TERMS, self.transform, strict=True))
        return f"{'aligned' if self.aligned else 'not aligned'}, {terms}"

    def refuse(self) -> None:
        """Raises ConfigError unless points are in the sensor's coordinates."""
        if not self.in_sensor_coordinates:
            raise ConfigError(
                f"the Gocator's points are not in its own coordinates (alignment: {self}); clear the alignment and the transformation "
                "in its web page, or set the scanner option allow_aligned: true and never align it again"
            )


def main_transform(data: bytes) -> tuple[float, ...]:
    """The six terms of ``_live.tfm`` for the main sensor; 0 where the file names none. Raises ProtocolError."""
    root = xmlfile.parse(data, "transformation", "Transform")
    device = root.find("Devices/Device[@role='0']")
    if device is None:
        device = root.find("Devices/Device")
    return tuple(0.0 if device is None else _term(device, name) for name in _TERMS)


def _term(device: ElementTree.Element, name: str) -> float:
    text = device.findtext(name, "0")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ProtocolError(f"the sensor's transformation says '{text}' for {name} instead of a number")
    return value
