"""One connected sensor: its three channels and the conversations that need several commands."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, MbcacqError, ProtocolError
from mbcacq_gocator import commands, information, wire
from mbcacq_gocator.configuration import SCAN_MODES, SOFTWARE, SURFACE, TRIGGER_SOURCES, Configuration
from mbcacq_gocator.control import ControlChannel, SensorRefused
from mbcacq_gocator.health import HealthReader
from mbcacq_gocator.information import SystemInfo
from mbcacq_gocator.options import Options

_NAME = struct.Struct("<64s")
_RECEIVE_BUFFER = 4 * 2**20
_SNAPSHOT_SINCE = (5, 2, 1)
_STOP_WAIT_S = 1.0
LIVE_CONFIGURATION, LIVE_JOB = "_live.cfg", "_live.job"


class Session:
    """Raises from ``open``: ConnectError, IdentityError, ConfigError, DeviceFault, DeviceTimeout, ProtocolError."""

    def __init__(self, options: Options, model: str, cancelled: Callable[[], bool] = lambda: False) -> None:
        self.options, self._model, self._cancelled = options, model, cancelled
        self.control = ControlChannel(options.address, options.control_port, options.connect_timeout_s, options.reply_limit_s)
        self.health = HealthReader(options.address, options.health_port, options.connect_timeout_s)
        self._data: socket.socket | None = None
        self.reader: wire.MessageReader | None = None
        self.info: SystemInfo | None = None
        self.configuration: Configuration | None = None
        self._settings = threading.Lock()

    def open(self) -> None:
        try:
            self.control.open()
            self.info = self._identify()
            if self.info.state != information.READY:
                self.control.request(commands.STOP)
            self.health.open()
            self._data = wire.connect(self.options.address, self.options.data_port, "data", self.options.connect_timeout_s, _RECEIVE_BUFFER)
            self.reader = wire.MessageReader(self._data, "scan", self._cancelled)
            if self.options.job:
                self.load_job(self.options.job)
            self.configuration = self.read_configuration()
            self._check_job(self.configuration)
            if self.options.exposure_us is not None:
                self.set_exposure(self.options.exposure_us)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self.control.close()
        self.health.close()
        wire.shut(self._data)
        self._data = self.reader = None

    def start(self) -> None:
        """Let the sensor run, waiting for triggers."""
        self.control.request(commands.START)

    def stop(self) -> None:
        """Ask for a stop, at most briefly waiting for another command to end."""
        self.control.request(commands.STOP, wait_s=_STOP_WAIT_S)

    def time_stamp(self) -> int:
        """The sensor's clock, in the unit of a stamp's timestamp."""
        return _unpack("<Q", self.control.request(commands.TIME_STAMP), "time stamp")[0]

    def states(self) -> dict[str, int]:
        return information.parse_states(self.control.request(commands.STATES))

    def loaded_job(self) -> str:
        return information.text(self.control.request(commands.LOADED_JOB)[:64])

    def jobs(self) -> list[str]:
        body = self.control.request(commands.LIST_FILES, _NAME.pack(b""))
        (count,) = _unpack("<I", body, "list of files")
        if 4 + 64 * count > len(body):
            raise ProtocolError(f"the Gocator announces {count} files but its list has {len(body)} bytes")
        names = [information.text(body[4 + 64 * i:68 + 64 * i]) for i in range(count)]
        return [name for name in names if name.endswith(".job") and not name.startswith("_live")]

    def load_job(self, name: str) -> None:
        """Make a stored job the live one, unless it is already. Raises ConfigError naming the stored jobs."""
        wanted = name if name.endswith(".job") else name + ".job"
        if self.loaded_job() == wanted:
            return
        stored = self.jobs()
        if wanted not in stored:
            raise ConfigError(f"the Gocator has no job '{wanted}' (stored: {', '.join(stored) or 'none'}); correct the job in the plan "
                              "or save it on the sensor")
        self.control.request(commands.COPY_FILE, _file_name(wanted) + _file_name(LIVE_JOB))

    def read_configuration(self) -> Configuration:
        return Configuration(self.read_file(LIVE_CONFIGURATION))

    def read_file(self, name: str) -> bytes:
        body = self.control.request(commands.READ_FILE, _file_name(name))
        (size,) = _unpack("<I", body, f"file {name}")
        if 4 + size > len(body):
            raise ProtocolError(f"the Gocator announces {size} bytes of {name} but sends {len(body) - 4}")
        return bytes(body[4:4 + size])

    def write_file(self, name: str, data: bytes) -> None:
        self.control.request(commands.WRITE_FILE, _file_name(name) + struct.pack("<I", len(data)) + data)

    def set_exposure(self, exposure_us: float) -> None:
        """Write the exposure into the live job, if it is another one. The sensor must be at rest."""
        with self._settings:
            configuration = self.read_configuration()
            if not configuration.exposes_for(exposure_us):
                configuration.set_exposure(exposure_us)
                self.write_file(LIVE_CONFIGURATION, configuration.values_only())
                configuration = self.read_configuration()
                if not configuration.exposes_for(exposure_us):
                    raise DeviceFault(f"the Gocator took an exposure of {configuration.exposure_us} us instead of {exposure_us:g} us; "
                                      "check the exposure settings of the job")
            self.configuration = configuration

    def _identify(self) -> SystemInfo:
        if self.control.version >= (101, 9):
            info = information.parse_info_2(self.control.request(commands.SYSTEM_INFO_2))
        else:
            info = information.parse_info_1(self.control.request(commands.SYSTEM_INFO_1))
        info.check_model(self._model)
        if info.state == information.CONFLICT:
            raise DeviceFault(f"the Gocator {info.model} (serial {info.serial}) reports a conflict; see its web page, and restart it")
        states = self.states()
        if states.get("security") and not states.get("login"):
            raise ConnectError(f"the Gocator {info.model} (serial {info.serial}) demands a log-in; switch its security off in its web page")
        if self.options.mode == "snapshot" and info.firmware[:3] < _SNAPSHOT_SINCE:
            raise ConfigError(f"firmware {info.firmware_text} of the Gocator has no snapshot; set the scanner option mode: trigger")
        return info

    def _check_job(self, configuration: Configuration) -> None:
        (mode,) = _unpack("<i", self.control.request(commands.SCAN_MODE), "scan mode")
        if mode != SURFACE:
            raise ConfigError(f"the Gocator's job '{self._job_name()}' scans in mode '{SCAN_MODES.get(mode, mode)}'; "
                              "choose the scan mode Surface")
        if self.options.mode == "trigger" and configuration.trigger_source != SOFTWARE:
            source = TRIGGER_SOURCES.get(configuration.trigger_source, configuration.trigger_source)
            raise ConfigError(f"the Gocator's job '{self._job_name()}' is triggered by '{source}'; choose Software as trigger source, "
                              "or the scanner option mode: snapshot")

    def _job_name(self) -> str:
        try:
            return self.loaded_job()
        except (SensorRefused, MbcacqError):
            return "live"


def _file_name(name: str) -> bytes:
    data = name.encode()
    if len(data) > 63:
        raise ConfigError(f"the file name '{name}' is longer than the 63 bytes that a Gocator allows")
    return _NAME.pack(data)


def _unpack(code: str, body: memoryview, what: str) -> tuple:
    try:
        return struct.unpack_from(code, body)
    except struct.error:
        raise ProtocolError(f"the Gocator's {what} has only {len(body)} bytes") from None
