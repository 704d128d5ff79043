"""Can this computer listen where the plan says, and on which interface is that?"""

from __future__ import annotations

import errno
import ipaddress
import socket
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

from mbcacq.doctor.line import CheckupLine
from mbcacq.plan import LoadedPlan

EVERYWHERE = ("0.0.0.0", "::", "")


def lines(loaded: LoadedPlan) -> Iterator[CheckupLine]:
    options = loaded.plan.robot.options
    if "bind" not in options:
        return
    address, port = str(options["bind"]), int(options.get("port", 0))
    interface = holder(address)
    where = f"{address}:{port}" + (f" on {interface}" if interface else "")
    try:
        kind = socket.AF_INET6 if ":" in address else socket.AF_INET
        with socket.socket(kind, socket.SOCK_DGRAM) as probe:
            probe.bind((address, port))
    except (OSError, OverflowError) as error:
        yield _refused(error, address, port)
        return
    if address in EVERYWHERE:
        yield CheckupLine(
            "warning",
            "network",
            f"the robot's telegrams are awaited on every interface, port {port}",
            "give the address of the card the controller is wired to as robot: options: bind",
        )
    elif interface and Path(f"/sys/class/net/{interface}/wireless").exists():
        yield CheckupLine(
            "warning", "network", f"{where} is a wireless interface; telegrams will come late", "wire the controller to a network card"
        )
    else:
        yield CheckupLine("ok", "network", f"{where} can be listened on")


def _refused(error: Exception, address: str, port: int) -> CheckupLine:
    number = getattr(error, "errno", None)
    have = ", ".join(f"{held} on {name}" for name, held in sorted(addresses().items())) or "no address"
    if number == errno.EADDRINUSE:
        return CheckupLine(
            "error",
            "network",
            f"{address}:{port} is taken by another program",
            "end it (a fake cell, a second mbcacq, KUKA's TestServer), or choose another port on both sides",
        )
    if number == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return CheckupLine(
            "error",
            "network",
            f"{address} is not an address of this computer, which has {have}",
            f"give the card wired to the controller this address (ip addr add {address}/24 dev CARD), or correct bind",
        )
    if number == errno.EACCES:
        return CheckupLine("error", "network", f"{address}:{port} may not be listened on by this user", "choose a port above 1023")
    return CheckupLine("error", "network", f"{address}:{port} cannot be listened on ({error})", "correct bind and port in the plan")


def addresses() -> dict[str, str]:
    """Interface -> IPv4 address, where the system reports it."""
    if sys.platform != "linux":
        return {}
    import fcntl

    found = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            try:
                answer = fcntl.ioctl(probe.fileno(), 0x8915, struct.pack("256s", name.encode()[:15]))  # SIOCGIFADDR
            except OSError:
                continue
            found[name] = str(ipaddress.IPv4Address(answer[20:24]))
    return found


def holder(address: str) -> str:
    """The interface that holds an address, '' if unknown."""
    return next((name for name, held in addresses().items() if held == address), "")
