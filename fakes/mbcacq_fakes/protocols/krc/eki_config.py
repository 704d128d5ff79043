"""The tag table of an EKI channel, read from its XML file: KSS (EKI 2, 3) and iiQKA.OS2 (EKI 6)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from defusedxml.ElementTree import fromstring

TYPES = ("INT", "REAL", "BOOL", "STRING", "FRAME")
_PLACEHOLDER = re.compile(r"\$\$(\w+):(\w+)\$\$")


@dataclass(frozen=True, kw_only=True)
class EkiConfig:
    """received: name under which KRL asks -> (path, type). sent: paths in order (KSS) or names -> type of the template's places.

    flags: path -> $FLAG raised when it arrives. alive: flag set while connected (KSS); lost: flag set when the connection is lost (EKI 6).
    """

    system: str
    port: int
    root: str
    received: dict[str, tuple[str, str]]
    sent: dict[str, str]
    flags: dict[str, int]
    limit: int
    buffer_bytes: int = 16384
    alive: int | None = None
    lost: int | None = None
    template: str = ""
    order: tuple[str, ...] = field(default=())


def read_config(text: str) -> EkiConfig:
    """Raises ValueError for what the controller would not load."""
    root = fromstring(text)
    return _iiqka(root) if root.tag == "Channel" else _kss(root)


def _kss(root) -> EkiConfig:
    inside = root.find("CONFIGURATION/INTERNAL")
    if root.tag != "ETHERNETKRL" or inside is None:
        raise ValueError("this is no EKI configuration (ETHERNETKRL/CONFIGURATION/INTERNAL is missing)")
    if root.findtext("CONFIGURATION/EXTERNAL/TYPE") != "Client" or inside.findtext("PROTOCOL", "TCP") != "TCP":
        raise ValueError("the fake controller listens for one TCP client")
    port = int(inside.findtext("PORT", "0"))
    if not 54600 <= port <= 54615:
        raise ValueError(f"port {port} is not one of the controller's (54600..54615)")
    received, flags = {}, {}
    for element in root.findall("RECEIVE/XML/ELEMENT"):
        tag, kind = element.get("Tag", ""), element.get("Type")
        if kind is not None:
            if kind not in TYPES:
                raise ValueError(f"type {kind} of {tag} does not exist")
            received[tag] = (tag, kind)
        if element.get("Set_Flag"):
            flags[tag] = int(element.get("Set_Flag"))
    sent = [e.get("Tag", "") for e in root.findall("SEND/XML/ELEMENT")]
    roots = {tag.split("/")[0] for tag in (*received, *flags)}
    if len(roots) != 1 or len(set(sent)) != len(sent):
        raise ValueError("all received elements need the same root, and no element may be sent twice")
    buffering, size, alive = inside.find("BUFFERING"), inside.find("BUFFSIZE"), inside.find("ALIVE")
    limit = int(buffering.get("Limit", "16")) if buffering is not None else 16
    if not 1 <= limit <= 512:
        raise ValueError(f"a buffer of {limit} elements is not possible (1..512)")
    return EkiConfig(
        system="kss",
        port=port,
        root=roots.pop(),
        received=received,
        sent=dict.fromkeys(sent, ""),
        flags=flags,
        limit=limit,
        buffer_bytes=int(size.get("Limit", "16384")) if size is not None else 16384,
        alive=int(alive.get("Set_Flag")) if alive is not None and alive.get("Set_Flag") else None,
        order=tuple(sent),
    )


def _iiqka(root) -> EkiConfig:
    receive, message = root.find("Receive"), root.findtext("Send/Message", "").strip()
    server = root.find("Connection/Server")
    if receive is None or server is None or root.find("Connection").get("Protocol") != "TCP":
        raise ValueError("this is no EKI 6 channel with a TCP server")
    names = [v.get("Name", "") for v in receive.iter("Value")]
    if len(set(names)) != len(names):
        raise ValueError("a value is named twice")
    received = {v.get("Name", ""): (v.get("Rule", ""), v.get("Type", "")) for v in receive.iter("Value")}
    if bad := [n for n, (_, kind) in received.items() if kind not in TYPES]:
        raise ValueError(f"the type of {bad[0]} does not exist")
    sent = {name: kind.upper() for name, kind in _PLACEHOLDER.findall(message)}
    separator = receive.get("Separator", "")
    event = re.fullmatch(r"\$FLAG\[(\d+)\]", receive.get("Event", ""))
    management = root.find("Behavior/ConnectionManagement")
    lost = re.fullmatch(r"\$FLAG\[(\d+)\]", management.get("CommErrorEvent", "") if management is not None else "")
    return EkiConfig(
        system="iiqka",
        port=int(server.get("Port", "0")),
        root=separator,
        received=received,
        sent=sent,
        flags={separator: int(event[1])} if event else {},
        limit=int(root.find("Buffering").get("Size", "16")),
        lost=int(lost[1]) if lost else None,
        template=message,
    )
