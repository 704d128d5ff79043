"""The resource tree of the fake sensor: what can be read, updated and called, and what it does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

OK, FAILED, WRONG_STATE, NOT_FOUND, PARAMETER, EXISTS = 1, 0, -1000, -999, -997, -987
ENGINE = "LMIFringeSnapshot"
ENGINES = "/scan/engines"
GROUP = f"{ENGINES}/{ENGINE}/scanners/scanner-0"
SENSOR = f"{GROUP}/sensors/sensor-0"
PREFIX = f"scan:{ENGINE}:scanner-0:"
STAMP, POINTS, UNIFORM = (f"{PREFIX}{key}" for key in ("stamp", "sensor-0SurfacePointCloud", "sensor-0UniformSurface"))
SOURCES = (STAMP, POINTS, UNIFORM)
SOFTWARE = 3  # source of the trigger
EXPOSURE_US = 100.0, 100_000.0


class RequestRefused(Exception):
    """A request that a sensor answers with a status other than 1."""

    def __init__(self, status: int, description: str) -> None:
        super().__init__(description)
        self.status = status


class Resources:
    """State of one sensor. trigger: called for a software trigger while it runs."""

    def __init__(self, serial: str, model: str, jobs: tuple[str, ...], trigger: Callable[[], None]) -> None:
        self.serial, self.model, self.api, self._trigger = serial, model, "1.0.0", trigger
        self.running = False
        self.jobs, self.loaded_job = list(jobs), jobs[0] if jobs else ""
        self.gdp_port, self.gdp_enabled = 0, False
        self.outputs: list[dict[str, Any]] = []
        self.align_state, self.remote = 0, False
        self.temperature_C, self.scan_count = 41, 0
        self.group: dict[str, Any] = {
            "triggerSettings": {"source": 0, "maxFrameRateEnabled": True, "frameRate": 5},
            "scanModeSettings": {"scanMode": 3, "intensityEnabled": False, "uniformSpacingEnabled": False},
        }
        self.sensor: dict[str, Any] = {
            "exposureSettings": {"exposureMode": 0, "singleExposure": 1200, "multipleExposures": [400, 1200, 4000]},
            "activeAreaSettings": {"activeArea": {"x": 0, "y": 0, "z": 0, "width": 100, "length": 154, "height": 110}},
        }

    @property
    def exposure_us(self) -> float:
        return float(self.sensor["exposureSettings"]["singleExposure"])

    def handle(self, method: str, path: str, payload: dict[str, Any], args: dict[str, Any]) -> dict[str, Any]:
        """The payload of the reply. Raises Refused."""
        path = path.rstrip("/")
        if method == "read":
            return self._read(path, args)
        if method == "update":
            return self._update(path, payload)
        if method == "call":
            return self._call(path, payload)
        raise RequestRefused(-998, f"method {method} is not known")

    def _read(self, path: str, args: dict[str, Any]) -> dict[str, Any]:
        readers: dict[str, Callable[[], dict[str, Any]]] = {
            "/version": lambda: {"apiVersion": self.api},
            "/environ/info": lambda: {"applicationType": 0, "serialNumber": self.serial, "model": self.model},
            "/environ/remoteController": lambda: {"remoteConnected": self.remote, "ipAddress": "192.168.1.50", "controlPort": 3640},
            "/system": lambda: {"runState": int(self.running), "autostart": False},
            "/system/metrics": lambda: {"appUpTime": 100, "cpuCoresUsedAvg": 0.5, "memUsed": 1000, "memCapacity": 4000},
            "/jobs": lambda: {"loadedJob": self.loaded_job},
            "/controls/gocator": lambda: {"enabled": self.gdp_enabled, "serverPort": self.gdp_port},
            "/controls/gocator/outputs": lambda: {"map": [dict(o) for o in self.outputs]},
            ENGINES: lambda: children([f"{ENGINES}/{ENGINE}"]),
            f"{ENGINES}/{ENGINE}/scanners": lambda: children([GROUP]),
            GROUP: lambda: {"displayName": "Scanner", "parameters": self.group},
            f"{GROUP}/sensors": lambda: children([SENSOR]),
            SENSOR: lambda: {"serialNumber": self.serial, "displayName": "Sensor", "parameters": self.sensor},
            f"{GROUP}/outputs": lambda: self._data_sources(bool(args.get("expandLevel"))),
            f"{GROUP}/alignment": lambda: {"alignState": self.align_state},
            f"{GROUP}/metrics": self._scanner_metrics,
            f"{SENSOR}/metrics": self._temperatures,
        }
        if path in readers:
            return readers[path]()
        raise RequestRefused(NOT_FOUND, "not found")

    def _scanner_metrics(self) -> dict[str, Any]:
        latency = {"currentSyncTime": 0, "processingLatencyAvg": 200, "processingLatencyMax": 250}
        return {"scanCount": self.scan_count, "frameCount": self.scan_count, **latency}

    def _temperatures(self) -> dict[str, Any]:
        return {"cameraTemp0": self.temperature_C, "cpuTemp": self.temperature_C + 9, "projectorTemp": self.temperature_C + 4}

    @staticmethod
    def _data_sources(expanded: bool) -> dict[str, Any]:
        ids = (STAMP, POINTS, UNIFORM)
        paths = [f"{GROUP}/outputs/{i.rsplit(':', 1)[1]}" for i in ids]
        return children(paths, [{"dataSourceId": i} for i in ids] if expanded else None)

    def _update(self, path: str, payload: dict[str, Any]) -> dict[str, Any]:
        if path == "/controls/gocator":
            self.gdp_enabled = bool(payload.get("enabled", self.gdp_enabled))
            return {}
        target = {GROUP: self.group, SENSOR: self.sensor}.get(path)
        if target is None:
            raise RequestRefused(NOT_FOUND, "not found")
        if self.running:
            raise RequestRefused(WRONG_STATE, "settings cannot be changed while the system runs")
        wanted = merged(target, payload.get("parameters", {}))
        low, high = EXPOSURE_US
        if path == SENSOR and not low <= float(wanted["exposureSettings"]["singleExposure"]) <= high:
            raise RequestRefused(PARAMETER, f"singleExposure is out of range {low:g} to {high:g}")
        target.update(wanted)
        return {}

    def _call(self, path: str, payload: dict[str, Any]) -> dict[str, Any]:
        calls: dict[str, Callable[[dict[str, Any]], None]] = {
            "/system/commands/start": lambda _: setattr(self, "running", True),
            "/system/commands/stop": lambda _: setattr(self, "running", False),
            "/jobs/commands/load": self._load,
            f"{GROUP}/actions/trigger": lambda _: self._software_trigger(),
            "/controls/gocator/outputs/commands/add": self._add_output,
            "/controls/gocator/outputs/commands/remove": self._remove_output,
        }
        if path not in calls:
            raise RequestRefused(NOT_FOUND, "not found")
        calls[path](payload)
        return {}

    def _load(self, payload: dict[str, Any]) -> None:
        if self.running:
            raise RequestRefused(WRONG_STATE, "a job cannot be loaded while the system runs")
        name = str(payload.get("name", ""))
        if name not in self.jobs:
            raise RequestRefused(NOT_FOUND, f"there is no job {name}")
        self.loaded_job = name
        self.outputs.clear()  # outputs belong to the job

    def _software_trigger(self) -> None:
        if not self.running or self.group["triggerSettings"]["source"] != SOFTWARE:
            raise RequestRefused(WRONG_STATE, "the scanner does not wait for a software trigger")
        self._trigger()

    def _add_output(self, payload: dict[str, Any]) -> None:
        source, number = payload.get("source"), payload.get("outputId")
        if source not in SOURCES or not isinstance(number, int):
            raise RequestRefused(PARAMETER, f"there is no data source {source}")
        if any(o["source"] == source for o in self.outputs):
            raise RequestRefused(EXISTS, f"{source} is an output already")
        for entry in self.outputs:
            entry["outputId"] += entry["outputId"] >= number and bool(payload.get("autoShift"))
        self.outputs.append({"source": source, "outputId": number})

    def _remove_output(self, payload: dict[str, Any]) -> None:
        left = [o for o in self.outputs if o["outputId"] != payload.get("outputId")]
        if len(left) == len(self.outputs):
            raise RequestRefused(NOT_FOUND, "there is no such output")
        self.outputs[:] = left


def children(paths: list[str], contents: list[dict[str, Any]] | None = None) -> dict[str, Any]:
    """A resource that embeds others, as HAL writes it; nothing is embedded where there are none."""
    if not paths:
        return {}
    extra = contents or [{} for _ in paths]
    return {"_embedded": {"item": [{"_links": {"self": {"href": p}}, **c} for p, c in zip(paths, extra, strict=True)]}}


def merged(target: dict[str, Any], patch: dict[str, Any]) -> dict[str, Any]:
    """A JSON merge patch (RFC 7386): maps are merged, all else is replaced, null removes."""
    out = dict(target)
    for key, value in patch.items():
        if value is None:
            out.pop(key, None)
        else:
            out[key] = merged(out.get(key, {}), value) if isinstance(value, dict) else value
    return out
