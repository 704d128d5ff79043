"""The resources of a GoPxL sensor that a driver needs, found by reading the tree instead of guessing its names."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from mbcacq.devices import ConfigError, ConnectError, IdentityError, ProtocolError
from mbcacq_gocator.gopxl.control import GoPxLControl

SYSTEM, START, STOP = "/system", "/system/commands/start", "/system/commands/stop"
JOBS, LOAD_JOB = "/jobs", "/jobs/commands/load"
GDP, GDP_OUTPUTS = "/controls/gocator", "/controls/gocator/outputs"
READY, RUNNING, CONFLICT = 0, 1, 2
SOFTWARE_TRIGGER, PROFILE_MODE, SURFACE_MODE, SINGLE_EXPOSURE = 3, 2, 3, 0
ALIGN_STATES = {0: "none", 1: "aligned", 2: "aligning"}
MAX_CHILDREN = 4096


@dataclass(frozen=True)
class SensorInfo:
    """model: as the sensor calls itself; api: version of its interface; build: of its firmware, '' if it does not say."""

    serial: int
    model: str
    api: str
    build: str = ""


@dataclass(frozen=True)
class ScannerPaths:
    """Paths of the sensor group and of the sensor in it."""

    group: str
    sensor: str

    @property
    def trigger(self) -> str:
        return f"{self.group}/actions/trigger"

    @property
    def source_prefix(self) -> str:
        """How the names of the scanner's own data sources begin: scan:ENGINE:SCANNER:"""
        parts = self.group.strip("/").split("/")
        return f"scan:{parts[-3]}:{parts[-1]}:"


def identify(control: GoPxLControl) -> SensorInfo:
    """Who answers. Raises ConnectError if another GoPxL instance owns the sensor, ProtocolError."""
    api = str(control.read("/version").get("apiVersion", ""))
    info = control.read("/environ/info")
    remote = control.read_if_there("/environ/remoteController")
    if remote.get("remoteConnected") is True:
        where = f"{remote.get('ipAddress', 'another computer')}:{remote.get('controlPort', 3600)}"
        raise ConnectError(f"the sensor is controlled by the GoPxL instance at {where}; give that address, or release the sensor there")
    serial = info.get("serialNumber", "")
    if not str(serial).isdigit():
        raise ProtocolError(f"GoPxL gives no serial number but {serial!r}")
    build = info.get("appVersion") or info.get("version") or ""
    return SensorInfo(int(serial), str(info.get("model", "")), api, str(build))


def check_identity(info: SensorInfo, model: str, serial: int | None, address: str) -> None:
    """Raises IdentityError."""
    if model and model.strip().lower() not in info.model.strip().lower():
        raise IdentityError(f"the plan expects a '{model}' but the sensor at {address} is a '{info.model}' (serial {info.serial})")
    if serial is not None and info.serial != serial:
        raise IdentityError(
            f"the plan asks for the sensor with serial {serial} but the one at {address} is serial {info.serial}; "
            "correct the serial or the address"
        )


def find_scanner(control: GoPxLControl, serial: int) -> ScannerPaths:
    """The sensor with this serial number, by engines, scanners and sensors. Raises ConfigError if there is none."""
    for engine in children(control.read("/scan/engines")):
        for group in children(control.read(f"{engine}/scanners")):
            for sensor in children(control.read(f"{group}/sensors")):
                if str(control.read(sensor).get("serialNumber", "")) == str(serial):
                    return ScannerPaths(group, sensor)
    raise ConfigError(f"GoPxL lists no sensor with serial {serial} in any scanner; add it on the page Scan of its web interface")


def children(payload: dict[str, Any]) -> list[str]:
    """Paths of the children that a resource embeds; one child may stand alone instead of in a list."""
    embedded = payload.get("_embedded")
    found = embedded.get("item") or embedded.get("go:scanner") or [] if isinstance(embedded, dict) else []
    items = found if isinstance(found, list) else [found]
    paths = [href for href in (_href(item) for item in items[:MAX_CHILDREN]) if href]
    return [path.rstrip("/") for path in paths]


def _href(item: Any) -> str:
    if not isinstance(item, dict):
        return ""
    links = item.get("_links")
    own = links.get("self") if isinstance(links, dict) else None
    href = own.get("href") if isinstance(own, dict) else item.get("href")
    return href if isinstance(href, str) else ""


def scan_source(control: GoPxLControl, scanner: ScannerPaths, mode: str, uniform: bool, asked: str = "") -> str:
    """Id of the data source of the scanner's own surface or profile.

    mode: 'surface' or 'profile'. asked: the plan's choice. Raises ConfigError naming what there is, where there is none, or more than one
    to choose from.
    """
    ids = data_sources(control.read(f"{scanner.group}/outputs", expandLevel=1))
    if asked:
        if asked not in ids:
            there = ", ".join(ids) or "none"
            raise ConfigError(f"the sensor has no data source '{asked}' (there are: {there}); correct the option source")
        return asked
    own = [i for i in ids if i.startswith(scanner.source_prefix)]
    keys = {i: i.rsplit(":", 1)[-1].lower() for i in own}
    scans = [i for i in own if ("profile" in keys[i]) == (mode == "profile") and re.search("surface|profile|pointcloud", keys[i])]
    fitting = [i for i in scans if ("uniform" in keys[i]) == uniform]
    if len(fitting) != 1:
        kind = f"uniform {mode}" if uniform else f"{mode} point cloud"
        raise ConfigError(
            f"the sensor offers {len(fitting)} outputs that could be its {kind} (there are: {', '.join(ids) or 'none'}); "
            "name one in the option source"
        )
    return fitting[0]


def data_sources(payload: dict[str, Any]) -> list[str]:
    """All ``dataSourceId`` below a resource, in order."""
    found: list[str] = []
    waiting: list[Any] = [payload]
    while waiting and len(found) < MAX_CHILDREN:
        node = waiting.pop()
        if isinstance(node, dict):
            identifier = node.get("dataSourceId")
            found += [identifier] if isinstance(identifier, str) else []
            waiting += list(node.values())
        elif isinstance(node, list):
            waiting += node
    return sorted(set(found))


def outputs(payload: dict[str, Any]) -> dict[str, int]:
    """Source -> output id of what is sent over GDP already; ``map`` is a list, or an object of such entries."""
    entries = payload.get("map", [])
    entries = list(entries.values()) if isinstance(entries, dict) else entries
    found = {}
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, dict) and isinstance(entry.get("source"), str) and isinstance(entry.get("outputId"), int):
            found[entry["source"]] = entry["outputId"]
    return found
