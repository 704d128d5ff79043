"""One connected GoPxL sensor: its control and data connections, and the conversations that need several requests."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from typing import Any

from mbcacq.devices import ConfigError, DeviceFault, DeviceTimeout, Scan
from mbcacq_gocator.conversion import picked
from mbcacq_gocator.gopxl import gdp, tree
from mbcacq_gocator.gopxl.control import JOB_S, STATE_S, GoPxLControl
from mbcacq_gocator.gopxl.options import GoPxLOptions
from mbcacq_gocator.gopxl.points import points_of, profile_block
from mbcacq_gocator.gopxl.restore import Found
from mbcacq_gocator.profiles import ProfileBlock
from mbcacq_gocator.sensor_session import SensorSession
from mbcacq_gocator.snapshot_scanner import FINEST_US, exposure_reported
from mbcacq_gocator.status import meaning


class GoPxLSession(SensorSession[GoPxLControl]):
    """found: the sensor as an earlier session of this run found it, None if this is the first."""

    def __init__(self, options: GoPxLOptions, model: str, cancelled: Callable[[], bool], found: Found | None = None) -> None:
        self.options = options
        times = options.connect_timeout_s, options.reply_limit_s, options.grace_s
        super().__init__(GoPxLControl(options.address, options.control_port, *times, cancelled), model, cancelled)
        self.info: tree.SensorInfo | None = None
        self.found, self._first = found or Found(), found is None
        self._scanner: tree.ScannerPaths | None = None
        self._stamped = False
        self._last_frame = -1
        self.exposure_us: float | None = None

    @property
    def scanner(self) -> tree.ScannerPaths:
        assert self._scanner is not None, "the session is not open"
        return self._scanner

    def _agree(self) -> None:
        self.info = tree.identify(self.control)
        tree.check_identity(self.info, self._model, self.options.serial, self.options.address)
        self._come_to_rest()
        self._choose_job()
        self._scanner = tree.find_scanner(self.control, self.info.serial)
        self._refuse_alignment()
        self._set_up()
        self._add_output()
        self._connect_data()

    def _come_to_rest(self) -> None:
        state = self.control.read(tree.SYSTEM, STATE_S).get("runState")
        if state == tree.CONFLICT:
            raise DeviceFault("GoPxL reports a conflict with another instance; see its web page, and restart the sensor")
        if self._first:
            self.found.running = state == tree.RUNNING
        if state == tree.RUNNING:
            self.control.call(tree.STOP, limit_s=STATE_S)

    def job(self) -> str:
        return str(self.control.read_if_there(tree.JOBS).get("loadedJob", ""))

    def _choose_job(self) -> None:
        loaded = self.job()
        if self._first:
            self.found.job = loaded
        wanted = self.options.job
        if wanted and wanted != loaded:
            self.control.call(tree.LOAD_JOB, {"name": wanted}, JOB_S)

    def alignment(self) -> str:
        """'none', or what the sensor does to its points: whether it is aligned, and the transformation, mm and deg."""
        state = self.control.read_if_there(f"{self.scanner.group}/alignment").get("alignState", 0)
        transform = self.control.read_if_there(f"{self.scanner.sensor}/transform").get("transform")
        terms = transform.items() if isinstance(transform, dict) else ()
        return ", ".join([tree.ALIGN_STATES.get(state, f"state {state}"), *(f"{name} {value}" for name, value in terms if value)])

    def _refuse_alignment(self) -> None:
        """Points are in the sensor's own frame only while it is not aligned."""
        if self.alignment().startswith("aligned") and not self.options.allow_aligned:
            raise ConfigError(
                "the sensor is aligned, so its points are in the frame of that alignment and not in its own; clear the alignment "
                "on the page Alignment of its web interface, or set allow_aligned: true and never align it again"
            )

    def _set_up(self) -> None:
        """Surfaces with intensity by software trigger, or profiles as the job triggers them; one exposure. What was set before is
        remembered."""
        if self._first:
            self.found.paths = self.scanner
            self._remember(self.scanner.group, self.found.scanner, "triggerSettings", "scanModeSettings")
            self._remember(self.scanner.sensor, self.found.sensor, "exposureSettings")
        streams = self.options.mode == "profile"
        modes = {
            "scanMode": tree.PROFILE_MODE if streams else tree.SURFACE_MODE,
            "intensityEnabled": not streams,
            "uniformSpacingEnabled": self.options.uniform,
        }
        if streams:
            self._refuse_software_trigger()
        trigger = {} if streams else {"triggerSettings": {"source": tree.SOFTWARE_TRIGGER}}
        self.control.update(self.scanner.group, {"parameters": {**trigger, "scanModeSettings": modes}})
        if self.options.exposure_us is not None:
            self.set_exposure(self.options.exposure_us)
        else:
            self.exposure_us = self._exposure()

    def _refuse_software_trigger(self) -> None:
        parameters = self.control.read(self.scanner.group).get("parameters")
        trigger = parameters.get("triggerSettings") if isinstance(parameters, dict) else None
        if isinstance(trigger, dict) and trigger.get("source") == tree.SOFTWARE_TRIGGER:
            raise ConfigError(
                f"the sensor's job '{self.job()}' is triggered by software, one profile at a time; choose Time, Encoder or External Input"
            )

    def _remember(self, path: str, kept: dict[str, Any], *keys: str) -> None:
        parameters = self.control.read(path).get("parameters")
        if isinstance(parameters, dict):
            kept.update({key: parameters[key] for key in keys if isinstance(parameters.get(key), dict)})

    def _exposure(self) -> float | None:
        parameters = self.control.read(self.scanner.sensor).get("parameters")
        settings = parameters.get("exposureSettings") if isinstance(parameters, dict) else None
        value = settings.get("singleExposure") if isinstance(settings, dict) else None
        return float(value) if isinstance(value, int | float) else None

    def exposure_set(self) -> str:
        return exposure_reported(self._exposure() or 0.0, self.exposure_us)

    def set_exposure(self, exposure_us: float) -> None:
        """Set one exposure and read it back; a running sensor is stopped for it. Raises DeviceFault if another one was taken."""
        if self.exposure_us is not None and abs(self.exposure_us - exposure_us) < FINEST_US:
            return
        self.stop()
        settings = {"exposureMode": tree.SINGLE_EXPOSURE, "singleExposure": exposure_us}
        self.control.update(self.scanner.sensor, {"parameters": {"exposureSettings": settings}})
        self.exposure_us = self._exposure()
        if self.exposure_us is None or abs(self.exposure_us - exposure_us) > FINEST_US:
            raise DeviceFault(f"the sensor took an exposure of {self.exposure_us} us instead of {exposure_us:g} us; check its limits")

    def _add_output(self) -> None:
        """Have the scans, and a stamp where the sensor has one to send, sent over GDP; add what is missing only."""
        if self._first:
            self.found.protocol = self.control.read(tree.GDP).get("enabled") is True
        self.control.update(tree.GDP, {"enabled": True})
        there = tree.outputs(self.control.read(tree.GDP_OUTPUTS))
        wanted = [tree.scan_source(self.control, self.scanner, self.options.mode, self.options.uniform, self.options.source)]
        stamp = f"{self.scanner.source_prefix}stamp"
        self._stamped = stamp in tree.data_sources(self.control.read(f"{self.scanner.group}/outputs", expandLevel=1))
        if self._stamped:
            wanted.append(stamp)
        elif self.options.mode == "profile":
            raise ConfigError(f"the sensor has no data source '{stamp}', so nobody can tell when a profile was taken")
        for source in wanted:
            if source not in there:
                number = max([-1, *there.values()]) + 1
                self.control.call(f"{tree.GDP_OUTPUTS}/commands/add", {"source": source, "outputId": number, "autoShift": True})
                there[source] = number
                self.found.added.append(number)

    def _connect_data(self) -> None:
        port = self.options.data_port or self.control.read(tree.GDP).get("serverPort", 3601)
        if not isinstance(port, int) or not 0 < port < 65536:
            raise ConfigError(f"the sensor names {port!r} as the port of its data; give data_port in the plan")
        self._open_data(self.options.address, port, "GoPxL data", self.options.connect_timeout_s)

    def next_profiles(self, deadline: float) -> ProfileBlock | None:
        reader = self.reader
        return None if reader is None else profile_block(gdp.read_set(reader, deadline), self.options.right_handed)

    def start(self) -> None:
        if not self.running:
            self.control.call(tree.START, limit_s=STATE_S)
            self.running = True

    def stop(self) -> None:
        if self.running:
            self.control.call(tree.STOP, limit_s=STATE_S)
            self.running = False

    def expose(self, exposure_us: float | None) -> Scan:
        """Raises DeviceTimeout, ProtocolError, DeviceFault, ConnectError, Aborted."""
        if exposure_us is not None:
            self.set_exposure(exposure_us)
        self.start()
        self._discard_old()
        self.control.call(self.scanner.trigger, limit_s=STATE_S)
        found = self._wait_for_surface()
        assert found.surface is not None
        self.geometry = found.surface.layout
        self.exposure = exposure_reported(found.surface.exposure_us, self.exposure_us)
        points, pixel = points_of(found.surface, self.options.right_handed)
        shape = found.surface.raw.shape[:2]
        grey = found.surface.intensity
        return Scan(
            points=points,
            pixel=pixel,
            shape=(shape[0], shape[1]),
            intensity=None if grey is None else picked(grey, pixel),
            time_s=found.stamp.system_time_s if found.stamp else 0.0,
            frame=found.stamp.frame if found.stamp else 0,
            exposure_us=found.surface.exposure_us or self.exposure_us or 0.0,
            measurements={f"output_{number}": value for number, value in found.measurements.items()},
            health=self.health(),
        )

    def _discard_old(self) -> None:
        """Sets that came by themselves since the last scan, so that none of them is taken for the next one."""
        assert self.data is not None
        assert self.reader is not None
        deadline = time.monotonic() + self.options.timeout_s
        while select.select([self.data], [], [], 0)[0]:
            self._note(gdp.read_set(self.reader, deadline))

    def _note(self, found: gdp.GdpSet) -> bool:
        """Whether the set is newer than all before it. A sensor that sends no stamps is believed: what was older was discarded."""
        if found.stamp is None:
            return not self._stamped
        newer = found.stamp.frame > self._last_frame
        self._last_frame = max(self._last_frame, found.stamp.frame)
        return newer

    def _wait_for_surface(self) -> gdp.GdpSet:
        assert self.reader is not None
        deadline = time.monotonic() + self.options.timeout_s
        other = ""
        while True:
            try:
                found = gdp.read_set(self.reader, deadline)
            except DeviceTimeout as error:
                came = f"; the sensor sent {other}" if other else f": {error}"
                raise DeviceTimeout(
                    f"no scan within {self.options.timeout_s:g} s{came}; check in the web interface that the surface is an "
                    "output of the protocol Gocator, and that its port is not blocked"
                ) from None
            if self._note(found) and found.surface is not None:
                return found
            other = f"'{_status(found)}' instead of a surface" if found.refused else "sets without a surface, or old ones"

    def health(self) -> dict[str, float]:
        """Temperatures and counters by name, of the sensor, its group and the system; a temperature's name ends in _C."""
        values: dict[str, float] = {}
        for path in (f"{self.scanner.sensor}/metrics", f"{self.scanner.group}/metrics", "/system/metrics"):
            for name, value in self.control.read_if_there(path).items():
                if isinstance(value, int | float) and not isinstance(value, bool):
                    values[f"{name}_C" if "temp" in name.lower() else name] = float(value)
        return values


def _status(found: gdp.GdpSet) -> str:
    return meaning(next(iter(found.refused.values())))
