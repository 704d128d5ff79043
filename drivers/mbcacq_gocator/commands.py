"""Commands of the control channel: number, name for people, and how long the sensor may take to answer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GocatorCommand:
    id: int
    name: str
    limit_s: float


PROTOCOL_VERSION = GocatorCommand(0x4511, "protocol version", 1)
SYSTEM_INFO_1 = GocatorCommand(0x4002, "system info", 2)
SYSTEM_INFO_2 = GocatorCommand(0x4010, "system info", 2)
STATES = GocatorCommand(0x4525, "states", 3)
LOG_IN = GocatorCommand(0x4003, "log in", 2)
LIST_FILES = GocatorCommand(0x101A, "list files", 3)
READ_FILE = GocatorCommand(0x1007, "read file", 15)
WRITE_FILE = GocatorCommand(0x1006, "write file", 60)
COPY_FILE = GocatorCommand(0x101B, "copy file", 15)
LOADED_JOB = GocatorCommand(0x4512, "loaded job", 1)
START = GocatorCommand(0x100D, "start", 15)
STOP = GocatorCommand(0x1001, "stop", 15)
SNAPSHOT = GocatorCommand(0x4528, "snapshot", 5)
TRIGGER = GocatorCommand(0x4510, "software trigger", 1)
TIME_STAMP = GocatorCommand(0x100A, "time stamp", 1)
SCAN_MODE = GocatorCommand(0x1005, "scan mode", 3)
