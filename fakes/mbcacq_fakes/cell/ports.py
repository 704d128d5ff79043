"""Where the fake cell's servers stand."""

from __future__ import annotations

import os
import random
import socket
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbcacq.errors import ConfigError, ConnectError

LOOPBACK = "127.0.0.1"
ANY = ("0.0.0.0", "", "::")
_NOT_DRAWN, _MOST_TRIES = (12_000, 32_000), 1000  # Linux draws from 32768 on, Windows and macOS from 49152 on
NEUTRAL = "neutral"  # a scanner of any other driver: no fake at the wire
FOLDER = "folder"  # a scanner's own program, which saves clouds
POSITIONERS = ("manual", "modbus", "serial")
SCANNERS = {  # driver -> its options that are ports, with where the sensor listens as delivered
    "gocator": {"control_port": 3190, "health_port": 3194, "data_port": 3196},
    "gopxl": {"control_port": 3600, "data_port": 3601},
}


def free_port() -> int:
    """A port that is free now, for UDP and TCP. The operating system does not give it to programs that ask for any free port, so it is
    still free when it is used. Raises ConnectError if there is none."""
    draw = random.SystemRandom()
    for _ in range(_MOST_TRIES):
        port = draw.randrange(*_NOT_DRAWN)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, socket.socket(socket.AF_INET, socket.SOCK_STREAM) as tcp:
            try:
                udp.bind((LOOPBACK, port))
                tcp.bind((LOOPBACK, port))
            except OSError:
                continue
            return port
    raise ConnectError(f"no free port was found between {_NOT_DRAWN[0]} and {_NOT_DRAWN[1]}; end other programs that listen")


def ipv4(host: str) -> str:
    """An address to send to, for one that a client binds."""
    return LOOPBACK if host in ANY else host


def refuse_foreign(fake: str, device: str, host: str, port: int) -> None:
    """Raises ConfigError where the fake of a device cannot listen at the plan's address: it is not this computer's, or taken."""
    try:
        with socket.create_server((host, port)):
            pass
    except OSError as error:
        at = f"{host}:{port}" if port else host
        raise ConfigError(
            f"the fake {fake} cannot listen at the plan's address {at} ({error.strerror}); "
            f"set the {device}'s address to {LOOPBACK} to try the plan against fakes"
        ) from error


def scanner_address(driver: str, options: Mapping[str, Any], ports: str) -> dict[str, Any]:
    """Host and ports (0: any free) of the fake sensor. Raises ConfigError if the plan's address is not this computer's."""
    usual = SCANNERS[driver]
    if ports == "free":
        return {"host": LOOPBACK, **dict.fromkeys(usual, 0)}
    host = str(options.get("address", LOOPBACK))
    refuse_foreign("sensor", "scanner", host, 0)
    return {"host": host, **{name: int(options.get(name) or port) for name, port in usual.items()}}


def line_address(port: str) -> dict[str, Any]:
    """Where a fake serial device stands for a plan's ``port``: the TCP port it names, or a pseudo-terminal to which a link of that name
    leads. Raises ConfigError for a port that is taken by something real."""
    if port.startswith(f"socket://{LOOPBACK}:"):
        return {"port": int(port.rsplit(":", 1)[1])}
    path = Path(port)
    if sys.platform == "win32" or path.is_symlink() or path.exists() or not path.is_absolute() or not os.access(path.parent, os.W_OK):
        raise ConfigError(
            f"the fake serial device cannot play the port {port}; use socket://{LOOPBACK}:PORT, or a name that does not "
            "exist yet (/tmp/lift), to try it"
        )
    return {"pty": True, "link": port}
