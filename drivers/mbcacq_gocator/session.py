"""One connected sensor: its three channels and the conversations that need several commands."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Mapping

from mbcacq.devices import ConfigError, DeviceFault, IdentityError, ProtocolError
from mbcacq_gocator import commands, information, jobs, layouts
from mbcacq_gocator.alignment import Alignment
from mbcacq_gocator.configuration import PROFILE, SCAN_MODES, SOFTWARE, SURFACE, TRIGGER_SOURCES, Configuration
from mbcacq_gocator.control import ControlChannel
from mbcacq_gocator.dataset import read_set
from mbcacq_gocator.files import LIVE_CONFIGURATION, SensorFiles, unpack
from mbcacq_gocator.health import HealthReader
from mbcacq_gocator.information import SystemInfo
from mbcacq_gocator.login import log_in
from mbcacq_gocator.options import GocatorOptions
from mbcacq_gocator.profiles import ProfileBlock, block_of
from mbcacq_gocator.sensor_session import SensorSession
from mbcacq_gocator.snapshot_scanner import exposure_reported
from mbcacq_gocator.status import SensorRefused

_SNAPSHOT_SINCE = (5, 2, 1)
_STOP_WAIT_S = 1.0


class GocatorSession(SensorSession[ControlChannel]):
    """``before``: the sensor as an earlier session of this run found it, None if this is the first."""

    def __init__(
        self, options: GocatorOptions, model: str, cancelled: Callable[[], bool] = lambda: False, before: jobs.Before | None = None
    ) -> None:
        self.options, self.before = options, before
        times = options.connect_timeout_s, options.reply_limit_s, options.grace_s
        super().__init__(ControlChannel(options.address, options.control_port, *times), model, cancelled)
        self.files = SensorFiles(self.control)
        self.health = HealthReader(options.address, options.health_port, options.connect_timeout_s)
        self.info: SystemInfo | None = None
        self.configuration: Configuration | None = None
        self.alignment: Alignment | None = None
        self._settings = threading.Lock()

    def _agree(self) -> None:
        options = self.options
        self.info = self._identify()
        if self.info.state != information.READY:
            self.control.request(commands.STOP)
        self.health.open()
        self._open_data(options.address, options.data_port, "data", options.connect_timeout_s, layouts.size_limit)
        self.before = self.before or jobs.Before.of(self.files)
        self._choose_job(self.before)
        self.configuration = self._read_configuration()
        self._check_job(self.configuration)
        self.alignment = Alignment.read(self.control, self.files)
        if not options.allow_aligned:
            self.alignment.refuse()
        for exposure_us in options.exposures_us:
            self.configuration.check_exposure(exposure_us)
        if options.exposure_us is not None:
            self.set_exposure(options.exposure_us)

    def next_profiles(self, deadline: float) -> ProfileBlock | None:
        reader = self.reader
        return None if reader is None else block_of(read_set(reader, deadline))

    def close(self) -> None:
        super().close()
        self.health.close()

    def start(self) -> None:
        if not self.running:
            self.control.request(commands.START)
            self.running = True

    def stop(self) -> None:
        """Ask for a stop, at most briefly waiting for another command to end."""
        self.running = False
        self.control.request(commands.STOP, wait_s=_STOP_WAIT_S)

    def time_stamp(self) -> int:
        """The sensor's clock, in the unit of a stamp's timestamp."""
        return unpack("<Q", self.control.request(commands.TIME_STAMP), "time stamp")[0]

    def settings(self) -> dict[str, str]:
        """How the sensor is set up, for the records. The hash is of the live configuration as it would be written back."""
        assert self.configuration is not None
        return {
            "job": self.job(),
            "alignment": str(self.alignment),
            **self.configuration.scan_settings(),
            "configuration_sha256": hashlib.sha256(self.configuration.values_only()).hexdigest(),
        }

    def check_alignment(self) -> None:
        """Raises DeviceFault where somebody has aligned the sensor, or cleared its alignment, since it was connected."""
        now = Alignment.read(self.control, self.files)
        if now != self.alignment:
            raise DeviceFault(
                f"the Gocator's alignment changed during the run, from '{self.alignment}' to '{now}'; scans before and after cannot be "
                "compared: keep others away from its web page, and start a new run"
            )

    def exposure_set(self) -> str:
        """Raises DeviceFault where somebody has changed other settings."""
        before, now = self.configuration, self._read_configuration()
        assert before is not None, "the session is open"
        check_unchanged(before.scan_settings(), now.scan_settings())
        return exposure_reported(now.exposure_us or 0.0, before.exposure_us)

    def set_exposure(self, exposure_us: float) -> None:
        """Write the exposure into the live job, if it is another one; a running sensor is stopped for it."""
        with self._settings:
            configuration = self._read_configuration()
            if self.configuration is not None:
                check_unchanged(self.configuration.scan_settings(), configuration.scan_settings())
            if not configuration.exposes_for(exposure_us):
                if self.running:
                    self.stop()
                configuration.set_exposure(exposure_us)
                if self.before is not None:
                    self.before.changed = True
                self.files.write(LIVE_CONFIGURATION, configuration.values_only())
                configuration = self._read_configuration()
                if not configuration.exposes_for(exposure_us):
                    raise DeviceFault(
                        f"the Gocator took an exposure of {configuration.exposure_us} us instead of {exposure_us:g} us; "
                        "check the exposure settings of the job"
                    )
            self.configuration = configuration

    def _read_configuration(self) -> Configuration:
        return Configuration(self.files.read(LIVE_CONFIGURATION))

    def _choose_job(self, before: jobs.Before) -> None:
        if self.options.job:
            jobs.load(self.files, self.options.job, before)

    def _identify(self) -> SystemInfo:
        if self.control.version >= (101, 9):
            info = information.parse_info_2(self.control.request(commands.SYSTEM_INFO_2))
        else:
            info = information.parse_info_1(self.control.request(commands.SYSTEM_INFO_1))
        info.check_model(self._model)
        if self.options.serial is not None and info.serial != self.options.serial:
            raise IdentityError(
                f"the plan asks for the Gocator with serial {self.options.serial} but the sensor at {self.options.address} "
                f"is serial {info.serial}; correct the serial or the address"
            )
        if info.state == information.CONFLICT:
            raise DeviceFault(f"the Gocator {info.model} (serial {info.serial}) reports a conflict; see its web page, and restart it")
        log_in(self.control, self.options.password)
        if self.options.mode == "snapshot" and info.firmware[:3] < _SNAPSHOT_SINCE:
            raise ConfigError(f"firmware {info.firmware_text} of the Gocator has no snapshot; set the scanner option mode: trigger")
        return info

    def _check_job(self, configuration: Configuration) -> None:
        (mode,) = unpack("<i", self.control.request(commands.SCAN_MODE), "scan mode")
        streams = self.options.mode == "profile"
        if mode != (PROFILE if streams else SURFACE):
            wanted = "Profile, or another mode in the scanner's options" if streams else "Surface"
            raise ConfigError(
                f"the Gocator's job '{self.job()}' scans in mode '{SCAN_MODES.get(mode, mode)}'; choose the scan mode {wanted}"
            )
        if streams and configuration.trigger_source == SOFTWARE:
            raise ConfigError(
                f"the Gocator's job '{self.job()}' is triggered by software, one profile at a time; choose Time, Encoder or Input"
            )
        if self.options.mode == "trigger" and configuration.trigger_source != SOFTWARE:
            source = TRIGGER_SOURCES.get(configuration.trigger_source, configuration.trigger_source)
            raise ConfigError(
                f"the Gocator's job '{self.job()}' is triggered by '{source}'; choose Software as trigger source, "
                "or the scanner option mode: snapshot"
            )

    def job(self) -> str:
        """Name of the job that is loaded now."""
        try:
            return self.files.loaded_job()
        except (SensorRefused, ProtocolError):
            return "live"


def check_unchanged(before: Mapping[str, str], now: Mapping[str, str]) -> None:
    """Raises DeviceFault naming a setting that has changed; the hash changes with every exposure and does not count."""
    for name in sorted((before.keys() | now.keys()) - {"configuration_sha256"}):
        old, new = before.get(name, ""), now.get(name, "")
        if old != new:
            raise DeviceFault(
                f"the Gocator's setting '{name}' changed during the run, from '{old}' to '{new}'; scans before and after cannot be "
                "compared: keep others away from its web page, and start a new run"
            )
