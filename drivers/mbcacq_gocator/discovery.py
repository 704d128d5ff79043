"""Find Gocators on the networks of this computer (udp 3220), also those whose address does not fit them."""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from mbcacq.devices import ProtocolError
from mbcacq_gocator import broadcast
from mbcacq_gocator.broadcast import BROADCAST

PORT = 3220
_SIGNATURE = 0x0000504455494D4C  # "LMIUDP"
_GET_ADDRESS, _GET_INFO, _REPLY = 1, 5, 0x1000
_REQUEST = struct.Struct("<QQQQ")
_HEAD = struct.Struct("<QQqQH")
_INFO = struct.Struct("<II10x4s12xI17xH2xHH2x")  # serial, firmware, address, length of the network's prefix, ports
_OLD = struct.Struct("<QQqQQ12x4s4x4s16x")
_UNTOLD = (0, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class FoundSensor:
    """A sensor's answer. ``properties`` are its own words: PartNumber, ModelNumber, ModelDisplayName, Family, OpMode...

    Firmware before 5.1 sends serial and addresses only: its firmware is then (0, 0, 0, 0), its ports are the usual ones.
    """

    serial: int
    firmware: tuple[int, int, int, int] = _UNTOLD
    address: str
    prefix_length: int
    control_port: int = 3190
    health_port: int = 3194
    data_port: int = 3196
    properties: Mapping[str, str] = field(default_factory=dict)

    @property
    def model(self) -> str:
        return next((self.properties[k] for k in ("ModelNumber", "Model", "ModelDisplayName", "PartNumber") if self.properties.get(k)), "")


def find_sensors(timeout_s: float = 0.5, address: str = BROADCAST, port: int = PORT, serial: int = 0) -> list[FoundSensor]:
    """Every sensor that answers within ``timeout_s``, by serial number. serial: ask only this one (0 for all).

    Sensors answer by broadcast, so a firewall must let udp from port 3220 in. Raises ConnectError if nothing can be sent.
    """
    # The second for firmware before 5.1, which knows no other.
    requests = [_REQUEST.pack(_REQUEST.size, kind, _SIGNATURE, serial) for kind in (_GET_INFO, _GET_ADDRESS)]
    found: dict[int, FoundSensor] = {}
    for sensor in broadcast.ask(requests, address, port, timeout_s, lambda data, _: parse_reply(data)):
        if sensor.firmware != _UNTOLD or sensor.serial not in found:
            found[sensor.serial] = sensor
    return [found[key] for key in sorted(found)]


def parse_reply(data: bytes) -> FoundSensor:
    """One reply datagram. Raises ProtocolError."""
    if len(data) == _OLD.size:
        return _parse_old(data)
    try:
        length, kind, status, signature, size = _HEAD.unpack_from(data)
        if (length, kind, status, signature, size) != (len(data), _REPLY + _GET_INFO, 1, _SIGNATURE, _INFO.size):
            raise ProtocolError(f"a datagram of {len(data)} bytes is no Gocator's discovery reply")
        serial, version, ip, prefix, control, health, data_port = _INFO.unpack_from(data, _HEAD.size)
        properties = _properties(data, _HEAD.size + _INFO.size)
    except (struct.error, IndexError):
        raise ProtocolError(f"a Gocator's discovery reply ends after {len(data)} bytes") from None
    return FoundSensor(
        serial=serial,
        firmware=tuple(version.to_bytes(4, "big")),
        address=socket.inet_ntoa(ip),
        prefix_length=prefix,
        control_port=control,
        health_port=health,
        data_port=data_port,
        properties=properties,
    )


def _parse_old(data: bytes) -> FoundSensor:
    length, kind, status, signature, serial, ip, mask = _OLD.unpack(data)
    prefix = int.from_bytes(mask, "big").bit_count()
    if (length, kind, status, signature) != (_OLD.size, _REPLY + _GET_ADDRESS, 1, _SIGNATURE) or serial >= 2**32:
        raise ProtocolError(f"a datagram of {len(data)} bytes is no Gocator's discovery reply")
    return FoundSensor(serial=serial, address=socket.inet_ntoa(ip), prefix_length=prefix)


def _properties(data: bytes, at: int) -> dict[str, str]:
    texts = []
    count, at = data[at], at + 1
    for _ in range(2 * count):
        end = at + 1 + data[at]
        if end > len(data):
            raise IndexError
        texts.append(data[at + 1 : end].decode("utf-8", "replace"))
        at = end
    return dict(zip(texts[::2], texts[1::2], strict=True))
