"""Addresses in a driver's options: whether they can be one, and whether they lead only to this computer, where nothing but a fake can
answer."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterator, Mapping
from typing import Any

ADDRESS_KEY = re.compile(r"addr|bind|host|(^|_)ip($|_)|eki|server|controller|serial|device|url|port", re.IGNORECASE)


HOST = r"^[\w:\[]([\w.%:-]*[\w\]])?$"  # a name or an IP address, without a port


def is_host(text: str) -> bool:
    """Whether a text can be the name or the IP address of a computer or device."""
    return re.match(HOST, text) is not None


def on_loopback_only(options: Mapping[str, Any]) -> bool:
    """Whether a robot's options lead nowhere but to this computer: what answers there can only be a fake. In doubt, no.

    Every text under a key that names a place must be a loopback address, and there must be one; no other text may be an address.
    """
    found = False
    for key, text in _texts(options):
        local = is_loopback(text)
        if local is None and not ADDRESS_KEY.search(key):
            continue
        if not local:
            return False
        found = True
    return found


def _texts(options: Any, key: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(options, Mapping):
        for name, value in options.items():
            yield from _texts(value, str(name))
    elif isinstance(options, list | tuple):
        for value in options:
            yield from _texts(value, key)
    elif isinstance(options, str) and options:
        yield key, options


def is_loopback(text: str) -> bool | None:
    """Whether an address, also with a port, leads to this computer; None if the text is no address."""
    host = re.sub(r"^\w+://", "", text).strip("[]")
    host = re.sub(r"^([^:]+):\d+$", r"\1", host)
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return None


def is_own_address(address: str) -> bool:
    """Whether an address is one of this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, 0))
        except OSError:
            return False
        return True
