"""The sensor's files: jobs and the live configuration, read, written and copied over the control channel."""

from __future__ import annotations

import struct

from mbcacq.devices import ConfigError, ProtocolError
from mbcacq_gocator import commands, information
from mbcacq_gocator.control import ControlChannel

LIVE_CONFIGURATION, LIVE_JOB, LIVE_TRANSFORM = "_live.cfg", "_live.job", "_live.tfm"
_MAX_FILES = 10_000
_NAME = struct.Struct("<64s")


class SensorFiles:
    """Raises SensorRefused, DeviceTimeout, ConnectError, ProtocolError; ConfigError for a name that the sensor cannot hold."""

    def __init__(self, control: ControlChannel) -> None:
        self._control = control

    def loaded_job(self) -> str:
        return information.text(self._control.request(commands.LOADED_JOB)[:64])

    def jobs(self) -> list[str]:
        body = self._control.request(commands.LIST_FILES, _NAME.pack(b""))
        (count,) = unpack("<I", body, "list of files")
        if 4 + 64 * count > len(body) or count > _MAX_FILES:
            raise ProtocolError(f"the Gocator announces {count} files but its list has {len(body)} bytes")
        names = [information.text(body[4 + 64 * i : 68 + 64 * i]) for i in range(count)]
        return [name for name in names if name.endswith(".job") and not name.startswith("_live")]

    def read(self, name: str) -> bytes:
        body = self._control.request(commands.READ_FILE, _packed(name))
        (size,) = unpack("<I", body, f"file {name}")
        if 4 + size > len(body):
            raise ProtocolError(f"the Gocator announces {size} bytes of {name} but sends {len(body) - 4}")
        return bytes(body[4 : 4 + size])

    def write(self, name: str, data: bytes) -> None:
        self._control.request(commands.WRITE_FILE, _packed(name) + struct.pack("<I", len(data)) + data)

    def copy(self, source: str, target: str) -> None:
        """With LIVE_JOB as target: load that job. The sensor must be at rest."""
        self._control.request(commands.COPY_FILE, _packed(source) + _packed(target))


def job_name(name: str) -> str:
    return name if name.endswith(".job") else name + ".job"


def unpack(code: str, body: memoryview, what: str) -> tuple:
    try:
        return struct.unpack_from(code, body)
    except struct.error:
        raise ProtocolError(f"the Gocator's {what} has only {len(body)} bytes") from None


def _packed(name: str) -> bytes:
    data = name.encode()
    if len(data) > 63:
        raise ConfigError(f"the file name '{name}' is longer than the 63 bytes that a Gocator allows")
    return _NAME.pack(data)
