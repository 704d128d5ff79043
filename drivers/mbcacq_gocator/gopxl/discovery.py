"""Discovery of GoPxL sensors: a broadcast on udp 3320, answered with JSON behind a header."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Any

from mbcacq.devices import ConnectError, ProtocolError, is_own_address
from mbcacq_gocator import broadcast
from mbcacq_gocator.broadcast import BROADCAST
from mbcacq_gocator.gopxl.options import GoPxLOptions

PORT = 3320
SIGNATURE = int.from_bytes(b"LMIGOPXL", "little")
ASK, ANNOUNCE = 1, 0x1001
MAX_DATAGRAM = 1536
_REQUEST = struct.Struct("<QQQ")
_HEADER = struct.Struct("<QQQQ")
_LOOK_S, _TRIES = 0.5, 3


@dataclass(frozen=True)
class FoundInstance:
    """What a GoPxL instance announces. remote: another instance controls this sensor. conflict: its address is taken twice."""

    serial: int
    model: str
    build: str
    address: str
    control_port: int
    data_port: int
    remote: bool = False
    conflict: bool = False


def request() -> bytes:
    return _REQUEST.pack(_REQUEST.size, ASK, SIGNATURE)


def parse(data: bytes, sender: str) -> FoundInstance:
    """One announcement; ``sender`` stands for an address to which nobody can connect. Raises ProtocolError."""
    try:
        _, kind, signature, _ = _HEADER.unpack_from(data)
        if kind != ANNOUNCE or signature != SIGNATURE or len(data) > MAX_DATAGRAM:
            raise ProtocolError(f"a datagram of {len(data)} bytes is no announcement of GoPxL")
        content = json.loads(data[_HEADER.size :].split(b"\0")[0].decode("utf-8"))
        if not isinstance(content, dict):
            raise ProtocolError("an announcement of GoPxL holds no JSON object")
        serial = str(content.get("SerialNumber", ""))
        return FoundInstance(
            serial=int(serial) if serial.isdigit() else 0,
            model=str(content.get("DeviceModel", "")),
            build=str(content.get("AppVersion", "")),
            address=_reachable(str(content.get("Address", "")), sender),
            control_port=_port(content, "ControlPort", 3600),
            data_port=_port(content, "GdpPort", 3601),
            remote=bool(content.get("IsRemote")),
            conflict=bool(content.get("AddressConflict")),
        )
    except (struct.error, ValueError, RecursionError):
        raise ProtocolError(f"a datagram of {len(data)} bytes cannot be read as an announcement of GoPxL") from None


def _port(content: dict[str, Any], key: str, usual: int) -> int:
    value = content.get(key, usual)
    return value if isinstance(value, int) and 0 < value < 65536 else usual


def _reachable(announced: str, sender: str) -> str:
    """The address announced, or the sender's: an instance that listens on all its addresses may announce 0.0.0.0, or its own loopback."""
    try:
        address = IPv4Address(announced.strip())
    except ValueError:
        return sender
    if address.is_unspecified or address.is_multicast or int(address) == 2**32 - 1:
        return sender
    return sender if address.is_loopback and not is_own_address(sender) else str(address)


def find(wait_s: float, address: str = BROADCAST, port: int = PORT, listen_port: int = PORT) -> list[FoundInstance]:
    """All that announce themselves within ``wait_s``, by serial number. Raises ConnectError where nothing can be sent.

    The vendor's client hears only what comes to its own port 3320, and sensors may answer there; so the request is sent from
    it, or from any port where another program has it.
    """
    instances = broadcast.ask([request()], address, port, wait_s, parse, listen_port)
    found = {(one.serial, one.address, one.control_port): one for one in instances}
    return [found[key] for key in sorted(found)]


def located(options: GoPxLOptions) -> GoPxLOptions:
    """The options with an address. Raises ConnectError if no sensor with that serial number answers."""
    if options.address.strip():
        return options
    found: list[FoundInstance] = []
    for _ in range(_TRIES):
        found = find(_LOOK_S, options.broadcast, options.discovery_port, options.discovery_listen_port)
        mine = [one for one in found if one.serial == options.serial and not one.remote]
        if mine:
            return options.model_copy(update={key: getattr(mine[0], key) for key in ("address", "control_port", "data_port")})
    others = ", ".join(f"{one.model or 'a sensor'} serial {one.serial} at {one.address}" for one in found[:8]) or "none does"
    raise ConnectError(
        f"no GoPxL sensor with serial {options.serial} answers a broadcast ({others}); check its power and cable, that "
        f"the firewall lets udp port {options.discovery_port} in, or give its address"
    )
