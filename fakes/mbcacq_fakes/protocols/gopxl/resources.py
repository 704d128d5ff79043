"""The resource tree of the fake sensor: what can be read, updated and called, and what it does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mbcacq_fakes.protocols.gopxl.digital_output import ROOT as DIGITAL_OUTPUT
from mbcacq_fakes.protocols.gopxl.digital_output import DigitalOutput
from mbcacq_fakes.protocols.gopxl.schema import LIMITS, schema_of

OK, FAILED, WRONG_STATE, NOT_FOUND, PARAMETER, EXISTS = 1, 0, -1000, -999, -997, -987
ENGINE = "LMIFringeSnapshot"
ENGINES = "/scan/engines"
GROUP = f"{ENGINES}/{ENGINE}/scanners/scanner-0"
SENSOR = f"{GROUP}/sensors/sensor-0"
PREFIX = f"scan:{ENGINE}:scanner-0:"
STAMP, POINTS, UNIFORM = (f"{PREFIX}{key}" for key in ("stamp", "sensor-0SurfacePointCloud", "sensor-0UniformSurface"))
# The vendor's samples are written for a laser line sensor; its paths lead to the same scanner.
LASER = "LMILaserLineProfiler"
# The name of its profile point cloud is by analogy: no public text has it.
LASER_STAMP, LASER_SURFACE, LASER_PROFILE, LASER_POINTS = (
    f"scan:{LASER}:scanner-0:{key}" for key in ("stamp", "topUniformSurface", "topUniformProfile", "topProfilePointCloud")
)
TOOL = "tools:ProfileBoundingBox-0:outputs:X"  # of the tool that every job of this sensor has: the middle of the profile along x
SOURCES = (STAMP, POINTS, UNIFORM, LASER_STAMP, LASER_SURFACE, LASER_PROFILE, LASER_POINTS, TOOL)
TIME, SOFTWARE = 0, 3  # sources of the trigger


class RequestRefused(Exception):
    """A request that a sensor answers with a status other than 1."""

    def __init__(self, status: int, description: str) -> None:
        super().__init__(description)
        self.status = status


class Resources:
    """State of one sensor. trigger: called for a software trigger while it runs; changed: with a path and what has changed there; catch_up:
    called before a stop, for the profiles of the time before it. line_rate_hz: of a line scanner, 0 for a snapshot sensor.

    recorded: frames that were taken while ``recording``; ``position``: the next of them that is shown while ``replaying``.
    """

    def __init__(self, serial: str, model: str, jobs: tuple[str, ...], trigger: Callable[[], None], line_rate_hz: float = 0.0) -> None:
        self.serial, self.model, self.api, self._trigger = serial, model, "1.0.0", trigger
        self.running = self.recording = self.replaying = False
        self.recorded: list[Any] = []
        self.position = 0
        self.changed: Callable[[str, dict[str, Any]], None] = lambda path, payload: None
        self.catch_up: Callable[[], None] = lambda: None
        self.line = line_rate_hz > 0
        self.jobs, self.loaded_job = list(jobs), jobs[0] if jobs else ""
        self.gdp_port, self.gdp_enabled = 0, False
        self.outputs: list[dict[str, Any]] = []
        self.align_state, self.remote = 0, False
        self.transform = dict.fromkeys(("x", "y", "z", "xAngle", "yAngle", "zAngle"), 0.0)
        self.temperature_C, self.scan_count = 41, 0
        self.quick_edit, self.name = False, "Sensor"
        self.content: dict[str, bytes] = {}  # of jobs that were saved or brought
        self.digital_output = DigitalOutput(serial)
        self.group: dict[str, Any] = {
            "triggerSettings": {"source": 0, "maxFrameRateEnabled": True, "frameRate": line_rate_hz or 5},
            "scanModeSettings": {"scanMode": 2 if self.line else 3, "intensityEnabled": False, "uniformSpacingEnabled": False},
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
        path = path.rstrip("/").replace(f"{ENGINES}/{LASER}", f"{ENGINES}/{ENGINE}")
        if method == "read":
            found = self._read(path, args)
            return {**found, "_schema": schema_of(found)} if args.get("includeSchema") else found
        if method == "update":
            return self._update(path, payload)
        if method == "call":
            return self._call(path, payload)
        if method == "create":
            return self._create(path, payload)
        if method == "delete":
            return self._delete(path)
        if method in ("sub", "unSub", "unsub", "stream", "cancelStream"):
            self._read(path, {})  # raises where there is nothing
            return {}
        raise RequestRefused(-998, f"method {method} is not known")

    def _read(self, path: str, args: dict[str, Any]) -> dict[str, Any]:
        readers: dict[str, Callable[[], dict[str, Any]]] = {
            "/version": lambda: {"apiVersion": self.api},
            "/environ/info": lambda: {"applicationType": 0, "serialNumber": self.serial, "model": self.model},
            "/environ/remoteController": lambda: {"remoteConnected": self.remote, "ipAddress": "192.168.1.50", "controlPort": 3640},
            "/environ/ipConfig": lambda: {"interfaces": [{"ipAddress": "192.168.1.10", "mask": "255.255.255.0"}]},
            "/scan/visibleSensors": lambda: {"sensors": [self._visible()]},
            "/system": lambda: {"runState": int(self.running), "quickEditEnabled": self.quick_edit, "autostart": False},
            "/system/info": lambda: {"appId": "fake"},
            "/replay/playback": lambda: {"enabled": self.replaying, "count": len(self.recorded), "index": self.position},
            "/replay/recording": lambda: {"enabled": self.recording},
            "/system/metrics": lambda: {"appUpTime": 100, "cpuCoresUsedAvg": 0.5, "memUsed": 1000, "memCapacity": 4000},
            "/jobs": lambda: {"loadedJob": self.loaded_job},
            "/jobs/files": lambda: children([f"/jobs/files/{name}" for name in self.jobs], [{"jobName": n} for n in self.jobs]),
            "/controls/gocator": lambda: {"enabled": self.gdp_enabled, "serverPort": self.gdp_port},
            "/controls/gocator/outputs": lambda: {"map": [dict(o) for o in self.outputs]},
            ENGINES: lambda: children([self._named(f"{ENGINES}/{ENGINE}")]),
            f"{ENGINES}/{ENGINE}": lambda: children([self._named(GROUP)], relation="go:scanner"),
            f"{ENGINES}/{ENGINE}/scanners": lambda: children([self._named(GROUP)]),
            GROUP: lambda: {"displayName": "Scanner", "parameters": self.group},
            f"{GROUP}/sensors": lambda: children([self._named(SENSOR)]),
            SENSOR: lambda: {"serialNumber": self.serial, "displayName": self.name, "parameters": self.sensor},
            f"{GROUP}/outputs": lambda: self._data_sources(bool(args.get("expandLevel"))),
            f"{GROUP}/alignment": lambda: {"alignState": self.align_state},
            f"{GROUP}/transform": lambda: {"transform": {}, "encoderResolution": 1.0, "speed": 100.0},  # what is in it nobody has said
            f"{GROUP}/metrics": self._scanner_metrics,
            f"{GROUP}/layout": lambda: {"grid": {"sensors": [{"sensorId": "sensor-0", "row": 0, "column": 0, "orientation": 0}]}},
            f"{SENSOR}/metrics": self._temperatures,
            f"{SENSOR}/transform": lambda: {"transform": self.transform},
        }
        if path in readers:
            return readers[path]()
        if (outputs := self.digital_output.read(path)) is not None:
            return outputs
        name = path.removeprefix("/jobs/files/").removesuffix("/data")
        if name in self.jobs and path == f"/jobs/files/{name}":
            return {"jobName": name}
        if name in self.jobs and path == f"/jobs/files/{name}/data":
            return {"content": self.content.get(name, b"job")}
        raise RequestRefused(NOT_FOUND, "not found")

    def _visible(self) -> dict[str, Any]:
        return {
            "serialNumber": self.serial,
            "model": self.model,
            "engineId": self._named(ENGINE),
            "path": self._named(SENSOR),
            "isLocal": True,
        }

    def _scanner_metrics(self) -> dict[str, Any]:
        latency = {"currentSyncTime": 0, "processingLatencyAvg": 200, "processingLatencyMax": 250}
        return {"scanCount": self.scan_count, "frameCount": self.scan_count, **latency}

    def _temperatures(self) -> dict[str, Any]:
        return {"cameraTemp0": self.temperature_C, "cpuTemp": self.temperature_C + 9, "projectorTemp": self.temperature_C + 4}

    def _named(self, path: str) -> str:
        """A path by the name that this sensor's engine has."""
        return path.replace(ENGINE, LASER) if self.line else path

    def _data_sources(self, expanded: bool) -> dict[str, Any]:
        ids = (LASER_STAMP, LASER_POINTS, LASER_PROFILE) if self.line else (STAMP, POINTS, UNIFORM)
        paths = [f"{self._named(GROUP)}/outputs/{i.rsplit(':', 1)[1]}" for i in ids]
        return children(paths, [{"dataSourceId": i} for i in ids] if expanded else None)

    def _update(self, path: str, payload: dict[str, Any]) -> dict[str, Any]:
        if path == "/controls/gocator":
            self.gdp_enabled = bool(payload.get("enabled", self.gdp_enabled))
            return {}
        if path in ("/replay/recording", "/replay/playback"):
            return self._switch_replay(path, bool(payload.get("enabled")))
        if path == "/system":
            self.quick_edit = bool(payload.get("quickEditEnabled", self.quick_edit))
            return {}
        if path.startswith(DIGITAL_OUTPUT):
            return _done(self.digital_output.update(path, payload))
        target = {GROUP: self.group, SENSOR: self.sensor}.get(path)
        if target is None:
            raise RequestRefused(NOT_FOUND, "not found")
        if self.running:
            raise RequestRefused(WRONG_STATE, "settings cannot be changed while the system runs")
        wanted = merged(target, payload.get("parameters", {}))
        low, high = LIMITS["singleExposure"]["minimum"], LIMITS["singleExposure"]["maximum"]
        if path == SENSOR and not low <= float(wanted["exposureSettings"]["singleExposure"]) <= high:
            raise RequestRefused(PARAMETER, f"singleExposure is out of range {low:g} to {high:g}")
        target.update(wanted)
        if path == SENSOR:
            self.name = str(payload.get("displayName", self.name))
        return {}

    def _switch_replay(self, path: str, on: bool) -> dict[str, Any]:
        if path == "/replay/playback":
            self.replaying, self.position = on, 0
            return {}
        if on and not self.recording:
            self.recorded.clear()
        self.recording = on
        return {}

    def next_recorded(self) -> Any:
        """The frame that a replay shows next, from the begin again after the last; None without one."""
        if not self.recorded:
            return None
        frame = self.recorded[self.position % len(self.recorded)]
        self.position = (self.position + 1) % len(self.recorded)
        return frame

    @property
    def free_period_s(self) -> float | None:
        """Time between two exposures that nobody asks for; None where the sensor waits for a trigger."""
        trigger = self.group["triggerSettings"]
        if not self.running or not (trigger["source"] == TIME or self.replaying):
            return None
        return 1.0 / max(float(trigger["frameRate"]), 0.1)

    def _seek(self, payload: dict[str, Any]) -> None:
        index = payload.get("index")
        if not isinstance(index, int) or not 0 <= index < max(len(self.recorded), 1):
            raise RequestRefused(PARAMETER, f"there is no recorded frame {index}")
        self.position = index

    def _call(self, path: str, payload: dict[str, Any]) -> dict[str, Any]:
        calls: dict[str, Callable[[dict[str, Any]], None]] = {
            "/system/commands/start": lambda _: self._run(True),
            "/system/commands/stop": lambda _: self._run(False),
            "/jobs/commands/load": self._load,
            "/jobs/commands/save": lambda given: self._keep_job(str(given.get("name", "")), b"job"),
            "/jobs/commands/rename": self._rename,
            "/replay/commands/seek": self._seek,
            f"{GROUP}/actions/trigger": lambda _: self._software_trigger(),
            f"{GROUP}/commands/align": lambda _: setattr(self, "align_state", 1),
            f"{GROUP}/commands/clearAlign": lambda _: setattr(self, "align_state", 0),
            "/controls/gocator/outputs/commands/add": self._add_output,
            "/controls/gocator/outputs/commands/remove": self._remove_output,
            "/controls/gocator/outputs/commands/removeAll": lambda _: self.outputs.clear(),
        }
        if path == "/system/commands/archive":
            return {"content": b"backup of " + self.serial.encode()}
        if path.startswith(DIGITAL_OUTPUT):
            return _done(self.digital_output.call(path, payload))
        if path not in calls:
            raise RequestRefused(NOT_FOUND, "not found")
        calls[path](payload)
        return {}

    def _create(self, path: str, payload: dict[str, Any]) -> dict[str, Any]:
        if path == "/jobs/files":
            self._keep_job(str(payload.get("name", "")), bytes(payload.get("content") or b""))
            return {"path": f"/jobs/files/{payload['name']}"}
        if path == f"{GROUP}/sensors":
            raise RequestRefused(NOT_FOUND, f"there is no sensor {payload.get('serialNumber')} on this network")
        if path == f"{ENGINES}/{ENGINE}/scanners":
            raise RequestRefused(EXISTS, "this sensor has one scanner")
        found = self.digital_output.create(path, payload)
        if found is None:
            raise RequestRefused(NOT_FOUND, "not found")
        return found

    def _run(self, on: bool) -> None:
        self.catch_up()  # at rest: the profiles of this start begin now
        before, self.running = self.running, on
        self.catch_up()
        if before != on:
            self.changed("/system", {"runState": int(on)})

    def _load(self, payload: dict[str, Any]) -> None:
        if self.running:
            raise RequestRefused(WRONG_STATE, "a job cannot be loaded while the system runs")
        name = str(payload.get("name", ""))
        if name not in self.jobs:
            raise RequestRefused(NOT_FOUND, f"there is no job {name}")
        self.loaded_job = name
        self.outputs.clear()  # outputs belong to the job

    def _keep_job(self, name: str, content: bytes) -> None:
        if not name:
            raise RequestRefused(PARAMETER, "a job needs a name")
        self.content[name] = content
        if name not in self.jobs:
            self.jobs.append(name)

    def _rename(self, payload: dict[str, Any]) -> None:
        old, new = str(payload.get("sourceName", "")), str(payload.get("destName", ""))
        if old not in self.jobs:
            raise RequestRefused(NOT_FOUND, f"there is no job {old}")
        self._keep_job(new, self.content.pop(old, b"job"))
        self.jobs.remove(old)

    def _delete(self, path: str) -> dict[str, Any]:
        name = path.removeprefix("/jobs/files/")
        if name == path or name not in self.jobs:
            raise RequestRefused(NOT_FOUND, "not found")
        self.jobs.remove(name)
        return {}

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


def _done(refusal: str | None) -> dict[str, Any]:
    """The answer to a change of the digital outputs; refusal: None where there is no such path, '' where it is done."""
    if refusal is None:
        raise RequestRefused(NOT_FOUND, "not found")
    if refusal:
        raise RequestRefused(PARAMETER, refusal)
    return {}


def children(paths: list[str], contents: list[dict[str, Any]] | None = None, relation: str = "item") -> dict[str, Any]:
    """A resource that embeds others, as HAL writes it; nothing is embedded where there are none."""
    if not paths:
        return {}
    extra = contents or [{} for _ in paths]
    return {"_embedded": {relation: [{"_links": {"self": {"href": p}}, **c} for p, c in zip(paths, extra, strict=True)]}}


def merged(target: dict[str, Any], patch: dict[str, Any]) -> dict[str, Any]:
    """A JSON merge patch (RFC 7386): maps are merged, all else is replaced, null removes."""
    out = dict(target)
    for key, value in patch.items():
        if value is None:
            out.pop(key, None)
        else:
            out[key] = merged(out.get(key, {}), value) if isinstance(value, dict) else value
    return out
