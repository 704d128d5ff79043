"""Which sockets of a process and its children are bound where, as the kernel tells (Linux)."""

import ipaddress
import re
import struct
from pathlib import Path


def family_of(pid):
    """The process and all below it."""
    found, open_ = set(), [pid]
    while open_:
        each = open_.pop()
        found.add(each)
        for task in Path(f"/proc/{each}/task").glob("*/children"):
            try:
                open_ += [int(child) for child in task.read_text().split() if int(child) not in found]
            except OSError:
                continue
    return found


def bound(pid):
    """(protocol, address, port) of every TCP listener and every bound UDP socket that is not connected."""
    inodes = set()
    for each in family_of(pid):
        for link in Path(f"/proc/{each}/fd").glob("*"):
            try:
                if match := re.fullmatch(r"socket:\[(\d+)\]", str(link.readlink())):
                    inodes.add(match[1])
            except OSError:
                continue
    found = set()
    for protocol, waiting in (("tcp", {"0A"}), ("tcp6", {"0A"}), ("udp", {"07"}), ("udp6", {"07"})):
        for line in Path(f"/proc/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] in waiting and fields[9] in inodes:
                host, port = fields[1].split(":")
                words = [int(host[k : k + 8], 16) for k in range(0, len(host), 8)]
                found.add((protocol, ipaddress.ip_address(b"".join(struct.pack("=I", word) for word in words)), int(port, 16)))
    return found
