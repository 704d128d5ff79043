"""The sensor's live configuration, ``_live.cfg``: reading settings and changing the exposure.

The configuration that is sent back carries values only. Attributes that the sensor adds for its clients (limits, options, effective values)
are left out, as the vendor's client leaves them out; the sensor merges the values into its own file.
"""

from __future__ import annotations

import copy
import math
import re
from xml.etree import ElementTree

from mbcacq.devices import ConfigError, ProtocolError
from mbcacq_gocator import xmlfile

TRIGGER_SOURCES = {0: "time", 1: "encoder", 2: "input", 3: "software"}
SCAN_MODES = {0: "video", 1: "range", 2: "profile", 3: "surface"}
EXPOSURE_MODES: dict[float, str] = {0: "single", 1: "multiple", 2: "dynamic"}
SOFTWARE, PROFILE, SURFACE, SINGLE = 3, 2, 3, 0
_DEVICE = "Setup/Devices/Device[@role='0']"
_SCAN_SETTINGS = {
    "scan_mode": "ScanMode",
    "uniform_spacing": "UniformSpacingEnabled",
    "intensity": "IntensityEnabled",
    "occlusion_reduction": "OcclusionReductionEnabled",
}
_PATTERN = re.compile("Pattern|Projector")
_ADDED_BY_SENSOR = {"min", "max", "minSource", "maxSource", "options", "used", "value"}


class Configuration:
    """One reading of ``_live.cfg``. Raises ProtocolError if the file is not what a sensor serves."""

    def __init__(self, data: bytes) -> None:
        self._root = xmlfile.parse(data, "configuration", "Configuration")

    @property
    def trigger_source(self) -> int:
        return int(self._number("Setup/Trigger/Source"))

    @property
    def exposure_us(self) -> float | None:
        """Exposure of the main sensor; None if the file does not say."""
        return _float(self._root.findtext(_DEVICE + "/Exposure"))

    def scan_settings(self) -> dict[str, str]:
        """Settings that decide which points a surface has and where they are, except the exposure; as the sensor writes them."""
        setup = {name: self._root.findtext(f"Setup/{tag}", "").strip() for name, tag in _SCAN_SETTINGS.items()}
        parts = {"filters": self._root.find("Setup/Filters"), "active_area": self._root.find(_DEVICE + "/ActiveArea")}
        device = self._root.find(_DEVICE)
        pattern = [node for node in (device if device is not None else ()) if _PATTERN.search(node.tag)]
        listed = {name: ", ".join(_leaves(node)) for name, node in parts.items() if node is not None}
        listed["pattern"] = ", ".join(f"{node.tag} {leaf}".strip() for node in pattern for leaf in _leaves(node))
        return {name: text for name, text in {**setup, **listed}.items() if text}

    def exposes_for(self, exposure_us: float) -> bool:
        """Whether this already is the exposure, to a nanosecond."""
        return self.exposure_us is not None and abs(self.exposure_us - exposure_us) < 1e-3

    def check_exposure(self, exposure_us: float) -> None:
        """Raises ConfigError outside the limits that the sensor states, or if the job chooses its exposure by itself."""
        mode = _float(self._root.findtext(_DEVICE + "/ExposureMode")) or 0.0
        if mode != SINGLE:
            kind = EXPOSURE_MODES.get(mode, "another kind of")
            raise ConfigError(
                f"the Gocator's job uses {kind} exposure, so {exposure_us:g} us cannot be set; choose single exposure "
                "in the job, or leave the exposure out of the plan"
            )
        node = self._node(_DEVICE + "/Exposure")
        low, most = _float(node.get("min")) or 0.0, _float(node.get("max"))
        high = math.inf if most is None else most
        if not low <= exposure_us <= high:
            raise ConfigError(
                f"an exposure of {exposure_us:g} us is outside the {low:g} to {high:g} us that the Gocator allows; change it in the plan"
            )

    def set_exposure(self, exposure_us: float) -> None:
        """Raises ConfigError as ``check_exposure``."""
        self.check_exposure(exposure_us)
        self._node(_DEVICE + "/Exposure").text = f"{exposure_us:.6f}"

    def values_only(self) -> bytes:
        """The file to write back."""
        root = copy.deepcopy(self._root)
        for node in root.iter():
            for name in _ADDED_BY_SENSOR & node.attrib.keys():
                del node.attrib[name]
        return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True).replace(b"\n", b"\r\n")

    def _node(self, path: str) -> ElementTree.Element:
        node = self._root.find(path)
        if node is None:
            raise ProtocolError(f"the sensor's configuration has no {path}; this driver knows files of firmware 4.x to 6.x")
        return node

    def _number(self, path: str) -> float:
        node = self._node(path)
        value = _float(node.text)
        if value is None:
            raise ProtocolError(f"the sensor's configuration says '{node.text}' for {path} instead of a number")
        return value


def _leaves(node: ElementTree.Element, above: str = "") -> list[str]:
    """Path and text of every element below that has no children; of ``node`` itself, its text alone."""
    if not len(node):
        return [f"{above} {(node.text or '').strip()}".strip()]
    return [leaf for child in node for leaf in _leaves(child, f"{above}/{child.tag}".lstrip("/"))]


def _float(value: str | None) -> float | None:
    """None where it is no finite number."""
    try:
        number = float(value or "nan")
    except ValueError:
        return None
    return number if math.isfinite(number) else None
